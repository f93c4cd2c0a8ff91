"""The room's section: arms unless it says otherwise, and what a gantry has instead."""

from __future__ import annotations

from pathlib import Path

import pytest

from twinct.core.errors import ScenarioError
from twinct.scenario import Cell, GantryCell, Scenario, load_scenario, stage_digests

DEMO = Path(__file__).parents[2] / "scenarios" / "demo.yaml"
GANTRY = "cell.kind=gantry"


def problems(*overrides: str) -> str:
    with pytest.raises(ScenarioError) as caught:
        load_scenario(DEMO, overrides)
    return str(caught.value)


def cell(tmp_path: Path, text: str, *overrides: str) -> Cell | GantryCell:
    file = tmp_path / "mine.yaml"
    file.write_text(f"extends: {DEMO}\ncell: {{source_arm: {{speed_scale: 0.4}}}}\n")
    other = tmp_path / "other.yaml"
    other.write_text(f"extends: {file}\ncell: {text}\n")
    return load_scenario(other, overrides).cell


def test_a_section_without_kind_has_arms(tmp_path: Path) -> None:
    for text in ("{floor_z_mm: -1500}", "{kind: arms, floor_z_mm: -1500}"):
        found = cell(tmp_path, text)
        assert isinstance(found, Cell)
        assert (found.source_arm.speed_scale, found.floor_z_mm) == (0.4, -1500)


def test_a_gantry_starts_afresh(tmp_path: Path) -> None:
    assert cell(tmp_path, "{kind: gantry}") == GantryCell(kind="gantry")
    assert cell(tmp_path, "{}", GANTRY) == GantryCell(kind="gantry")
    for overrides in ((GANTRY, "cell.view_s=3"), ("cell.view_s=3", GANTRY)):
        assert cell(tmp_path, "{}", *overrides) == GantryCell(kind="gantry", view_s=3)
    arms = cell(tmp_path, "{kind: gantry, view_s: 3}", "cell.kind=arms")
    assert arms == Cell()


def test_keys_of_the_other_kind_are_refused_by_name() -> None:
    text = problems(GANTRY, "cell.source_arm.model=ur10e")
    assert "cell.source_arm: gantry has no such key, but arms has it: change cell.kind" in text
    assert "cell.view_s: arms has no such key, but gantry has it" in problems("cell.view_s=1")
    assert "unknown key; did you mean 'view_s'?" in problems(GANTRY, "cell.views=1")
    assert "cell.kind: kind 'gantri' is not one of 'arms', 'gantry'; did you mean" in problems(
        "cell.kind=gantri"
    )
    assert "cell.view_s: must be greater than or equal to 0.000001, but is 0" in problems(
        GANTRY, "cell.view_s=0"
    )


def test_an_exposure_is_no_longer_than_its_view() -> None:
    blur = [GANTRY, "source.motion_samples=2", "cell.view_s=0.02", "source.exposure_ms=21"]
    text = problems(*blur)
    assert text.startswith("--set source.exposure_ms=21: source.exposure_ms (21) must be at most")
    assert "20 ms (cell.view_s)" in text
    for fine in ("source.motion_samples=1", "source.exposure_ms=20"):
        load_scenario(DEMO, [*blur, fine])


def test_a_gantry_counts_and_what_arms_read_does_not() -> None:
    def digests(*overrides: str) -> dict[str, str]:
        return dict(stage_digests(load_scenario(DEMO, overrides)))

    def changed(*overrides: str) -> set[str]:
        now = digests(GANTRY, *overrides)
        return {stage for stage, digest in digests(GANTRY).items() if now[stage] != digest}

    arms, gantry = digests(), digests(GANTRY)
    assert {stage for stage in arms if arms[stage] == gantry[stage]} == {"surface"}
    assert changed("motion.trigger=settled", "cell.floor_z_mm=-900") == set()
    assert changed("cell.view_s=2") == {"executed", "images", "believed", "volume"}
    assert digests("cell.kind=arms") == arms
    assert changed("trajectory.views=5") >= {"plan"}
    # What it was before there was a gantry: results of arms stay valid.
    before = ("cell.source_arm", 850), ("cell.detector_arm", -850)
    then = [f"{arm}.base_position_mm=[{x}, 0, 0]" for arm, x in before]
    then += [f"{arm}.standoff_mm=150" for arm, _ in before]
    other_floor = digests("cell.floor_z_mm=-1500", "motion.scheme=reactive", *then)
    assert other_floor["plan"].startswith("c8defc6e894a")


def test_the_example_is_a_full_circle_with_exact_poses() -> None:
    example: Scenario = load_scenario(DEMO.with_name("circle_gantry.yaml"))
    assert (example.cell.kind, example.trajectory.kind) == ("gantry", "circle")
    assert example.uncertainty.source.sigma_mm == example.uncertainty.detector.sigma_mm == 0
