"""``twinct.check``: findings and warnings of a scenario, or its refusal with a remedy."""

from __future__ import annotations

from pathlib import Path

import pytest

import twinct
from twinct.core.errors import InputError, ScenarioError, TrajectoryError
from twinct.observers import Said
from twinct.scenario import load_scenario

SMALL = {
    "trajectory.views": 8,
    "detector": {"columns": 32, "rows": 24, "pixel_pitch_mm": 10},
    "specimen.parts": [{"shape": {"kind": "sphere", "radius_mm": 40, "mesh_resolution_mm": 8}}],
    "reconstruction.grid": {"voxels": 20, "voxel_mm": 8},
}


def test_findings_and_warnings_are_returned_and_told() -> None:
    moved = {**SMALL, "specimen.position_mm": [0, 0, 900]}
    clean = twinct.check(load_scenario("circle_gantry", SMALL))
    assert clean.findings["views"].startswith("8, ") and clean.warnings == ()
    heard: list[str] = []
    with pytest.raises(TrajectoryError, match="no view sees the specimen"):
        twinct.check(load_scenario("circle_gantry", moved))
    beside = {"specimen.position_mm": [0, 0, 80], "reconstruction.grid.voxels": 5}
    checked = twinct.check(
        load_scenario("circle_gantry", {**SMALL, **beside}),
        observers=[lambda event: heard.append(event.text) if isinstance(event, Said) else None],
    )
    assert checked.warnings and list(checked.warnings) == heard


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        (
            {"detector.scatter": {"kind": "monte_carlo", "voxel_mm": 0.01}},
            r"scatter\.voxel_mm 0\.01",
        ),
        (
            {"detector.scatter": {"kind": "monte_carlo"}, "source.energy_kev": 200},
            "source: photons of 200 keV; .* 1 to 150 keV",
        ),
    ],
)
def test_scatter_that_cannot_be_simulated_is_refused_before_work(keys, said) -> None:
    with pytest.raises(InputError, match=said):
        twinct.check(load_scenario("circle_gantry", {**SMALL, **keys}))


def test_a_file_is_taken_too(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="nowhere"):
        twinct.check(tmp_path / "nowhere.yaml")


def test_a_view_out_of_reach_is_refused_without_a_picture(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    away = {"cell.source_arm.base_position_mm": [4000, 0, 0]}
    with pytest.raises(TrajectoryError, match="out of reach"):
        twinct.check(load_scenario("demo", {**SMALL, **away}), cures=False)
    assert not list(tmp_path.iterdir())
