"""Time of a run, from three small scans."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from twinct import needs
from twinct.runs import pilot
from twinct.runs.pilot import SIZES, expected_time, measured_time, predicted, small_scan
from twinct.scan import SimulationBuilder
from twinct.scenario import Scenario, load_scenario

SMALL = ["trajectory.views=30", "reconstruction.iterations=1"]
STAGES = ("plan", "motion", "xray", "storing", "truth", "reconstruction", "judge", "report")


def scenario(*overrides: str) -> Scenario:
    return load_scenario("circle_gantry", [*SMALL, *overrides])


def test_rates_and_what_is_done_once_are_found_again() -> None:
    def seconds(one: dict[str, list[float]], cold: bool) -> dict[str, float]:
        views, pixels = one["xray"]
        return {
            "xray": 0.02 * views + 3e-7 * pixels + 4 * cold,
            "reconstruction": 2e-9 * one["reconstruction"][0] + 5 * cold,
            "link": 6.0 if cold else 0.1,
        }

    small = [
        {
            "xray": [float(views), float(views * columns**2)],
            "reconstruction": [float(views * columns**2 * voxels)],
        }
        for views, columns, voxels in SIZES
    ]
    wanted = {"xray": [400.0, 400 * 3e5], "reconstruction": [1e11]}
    measured = [seconds(one, cold=number == 0) for number, one in enumerate(small)]
    found = predicted(small, measured, wanted)
    assert found == pytest.approx(seconds(wanted, cold=True), rel=1e-6)


def test_a_small_scan_has_views_of_the_run_and_its_field_of_view(tmp_path: Path) -> None:
    whole = load_scenario("demo")
    small = small_scan(whole, tmp_path, 8, 64, 48)
    path, few = SimulationBuilder(whole).requested, SimulationBuilder(small).requested
    assert len(few) == 8
    assert all((path.source == one).all(axis=1).any() for one in few.source)
    assert few.panel.size_mm == pytest.approx(path.panel.size_mm)
    grids = [one.reconstruction.volume_grid for one in (whole, small)]
    assert grids[1].size_mm == pytest.approx(grids[0].size_mm)
    assert small.detector.columns == 64 and max(grids[1].shape) == 48


def test_sizes_and_lengths_are_of_one_kind_and_physics_is_not() -> None:
    def kind(*overrides: str) -> str:
        return pilot._kind(scenario(*overrides), "local")

    assert kind("trajectory.views=7", "detector.columns=99", "seed=4") == kind()
    assert kind("reconstruction.relaxation=0.1", "reconstruction.iterations=3") == kind()
    assert kind("source.motion_samples=4") != kind()
    assert kind("reconstruction={algorithm: fdk}") != kind()
    assert kind("specimen.parts.0.shape.mesh_resolution_mm=3") != kind()


def test_damaged_times_count_as_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert expected_time(scenario(), "local") is None
    (tmp_path / "twinct").mkdir()
    (tmp_path / "twinct" / "small_scans.json").write_text("[1")
    assert expected_time(scenario(), "local") is None
    assert all(need.seconds is None for need in needs(scenario(), "local").values())


@pytest.mark.tutorial
@pytest.mark.process
def test_small_scans_are_taken_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(pilot, "_is_busy", lambda: False)
    monkeypatch.setattr(pilot, "SIZES", ((3, 12, 8), (4, 16, 10), (6, 24, 12)))
    first = measured_time(scenario(), "local")
    assert first is not None and first.whole > first.reconstruction > 0
    assert set(STAGES) <= set(first.stages)
    stages = needs(scenario(), "local").values()
    assert sum(need.seconds or 0 for need in stages) == pytest.approx(first.whole)
    kept = json.loads((tmp_path / "twinct" / "small_scans.json").read_text())
    assert len(kept) == 1
    monkeypatch.setattr(pilot, "_taken", None)  # a second time, no scan is taken
    assert measured_time(scenario("trajectory.views=12"), "local") is not None


def test_what_only_the_first_process_computes_does_not_count(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    processes: list[int] = []

    def taken(small: list[Scenario], *_: object) -> list[dict[str, float]]:
        """Bodies are cut once on a machine, libraries are loaded by each process."""
        cut, processes[:] = 40.0 * (not processes), [*processes, len(small)]
        loaded = dict.fromkeys((*STAGES, "link", "specimen", "other"), 3.0) | {"plan": 3.0 + cut}
        return [loaded, *[dict.fromkeys(loaded, 1.0)] * (len(small) - 1)]

    monkeypatch.setattr(pilot, "_taken", taken)
    time = measured_time(scenario(), "local")
    assert processes == [5, 1]
    assert time is not None and time.stages["plan"] == pytest.approx(3)
    assert time.stages["link"] == 3


@pytest.mark.tutorial
@pytest.mark.process
def test_a_scan_that_fails_gives_no_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert measured_time(scenario("specimen.position_mm=[0, 0, 900]"), "local") is None
