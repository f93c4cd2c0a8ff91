"""Each answer is that of a call of the library."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from twinct import needs, reach
from twinct.core.errors import InputError
from twinct.design.bench import Bench
from twinct.design.draft import Draft
from twinct.design.questions import (
    Checked,
    HeldViews,
    PlannedMotion,
    Projection,
    Question,
    ScanCosts,
    ShadedSphere,
    SmallVolume,
    preview,
    small,
)
from twinct.runs import simulate
from twinct.scan import SimulationBuilder
from twinct.scenario import Scenario, ScenarioText, load_scenario

OUT_OF_REACH = "cell.source_arm.base_position_mm=[2500, 0, 0]"


@pytest.fixture
def source(small_file: Path) -> ScenarioText:
    return ScenarioText(small_file, small_file.read_text(encoding="utf-8"))


@pytest.fixture
def far(source: ScenarioText) -> ScenarioText:
    """With a source arm that reaches nothing."""
    text = source.text.replace("cell:\n", "cell:\n  source_arm: {base_position_mm: [2500, 0, 0]}\n")
    return ScenarioText(source.path, text)


@pytest.fixture
def scenario(source: ScenarioText) -> Scenario:
    return load_scenario(source)


def test_views_are_held_as_the_plan_finds(source: ScenarioText, far: ScenarioText) -> None:
    bench = Bench()
    assert HeldViews(source).answered(bench).tolist() == [True] * 12
    assert not HeldViews(far).answered(bench).any()


def test_motion_is_the_plan_or_why_there_is_none(
    source: ScenarioText, far: ScenarioText, scenario: Scenario
) -> None:
    plan = SimulationBuilder(scenario).plan
    motion = PlannedMotion(source).answered(Bench())
    assert plan is not None
    assert motion.duration_s == plan.duration_s
    assert motion.clearance_mm == plan.clearance_mm.min()
    none = PlannedMotion(far).answered(Bench())
    assert none.plan is None and none.problems and none.refused == tuple(range(12))
    assert np.isnan(none.duration_s) and np.isnan(none.clearance_mm)


def test_the_coarse_shading_misses_little_of_the_reach(
    source: ScenarioText, scenario: Scenario
) -> None:
    shading = ShadedSphere(source, directions=60).answered(Bench())
    whole = reach(scenario, directions=60)
    np.testing.assert_allclose(shading.directions, whole.directions)
    assert not (shading.both & ~whole.both[0]).any()
    assert shading.both.sum() >= 0.9 * whole.both[0].sum() > 5
    assert not (shading.both & ~shading.alone.all(axis=0)).any()


def test_a_gantry_has_no_sphere(source: ScenarioText) -> None:
    gantry = ScenarioText(
        source.path, "extends: circle_gantry\ndetector: {columns: 48, rows: 32}\n"
    )
    with pytest.raises(InputError, match="needs arms"):
        ShadedSphere(gantry).answered(Bench())
    assert HeldViews(gantry).answered(Bench()).all()
    assert PlannedMotion(gantry).answered(Bench()).plan is None


def test_the_image_is_that_of_a_scan(source: ScenarioText, scenario: Scenario) -> None:
    bench = Bench()
    try:
        image = Projection(source, view=3, whole=True).answered(bench)
        imager = bench._imager
        assert imager is not None
        # A newer path has the same imager, and a larger panel another one.
        moved = ScenarioText(source.path, source.text.replace("views: 12", "views: 13"))
        assert Projection(moved, view=40, whole=True).answered(bench).shape == (32, 48)
        assert bench._imager is not None and bench._imager[1] is imager[1]
        wide = ScenarioText(source.path, source.text.replace("columns: 48", "columns: 400"))
        assert Projection(wide).answered(bench).shape == (32, 160)
        assert bench._imager[1] is not imager[1]
    finally:
        bench.close()
    gantry = small(scenario).with_({"detector": scenario.detector.model_dump(mode="json")})
    taken = simulate(gantry).transmission[3]
    np.testing.assert_allclose(image, taken, atol=2e-3)
    assert image.min() < 0.6


def test_a_preview_covers_the_panel(scenario: Scenario) -> None:
    fine = scenario.with_({"detector.columns": 640, "detector.rows": 480})
    panel = preview(fine).detector.panel
    assert (panel.columns, panel.rows) == (160, 120)
    assert panel.size_mm == pytest.approx(fine.detector.panel.size_mm)


def test_costs_are_those_of_the_run(source: ScenarioText, scenario: Scenario) -> None:
    costs = ScanCosts(source).answered(Bench())
    stages = needs(scenario, "local").values()
    assert costs.views == 12
    assert costs.memory_bytes == max(stage.memory_bytes for stage in stages)
    assert costs.exposure_s == 12 * scenario.source.exposure_ms / 1000


@pytest.mark.process  # compiles the kernels at the first use
def test_a_small_volume_is_near_the_truth(source: ScenarioText) -> None:
    found = SmallVolume(source, voxels=16).answered(Bench())
    assert max(found.volume.array.shape) == 16
    assert found.volume.array.shape == found.truth.array.shape
    alike = np.corrcoef(found.volume.array.ravel(), found.truth.array.ravel())[0, 1]
    assert alike > 0.7


def test_the_whole_check_says_what_check_says(source: ScenarioText, far: ScenarioText) -> None:
    assert Checked(source).answered(Bench())["views"] == "12, sinusoid"
    with pytest.raises(InputError):
        Checked(far).answered(Bench())


@pytest.mark.parametrize(
    ("key", "value", "asked"),
    [
        ("trajectory.latitude_amplitude_deg", 20, {HeldViews, PlannedMotion, Projection}),
        ("cell.source_arm.base_position_mm", [860, 0, 0], {HeldViews, PlannedMotion, ShadedSphere}),
        ("seed", 5, set()),
        ("reconstruction.iterations", 3, set()),
    ],
)
def test_a_change_asks_only_what_it_may_change(
    scenario: Scenario, key: str, value: object, asked: set[type[Question]]
) -> None:
    changed = scenario.with_({key: value})
    kinds = {HeldViews, PlannedMotion, Projection, ShadedSphere}
    differ = {kind for kind in kinds if kind.reads(changed) != kind.reads(scenario)}
    assert differ == asked


def test_a_changed_path_keeps_the_room_and_a_moved_base_keeps_the_images(small_file: Path) -> None:
    draft, bench = Draft.open(small_file), Bench()
    HeldViews(draft.source).answered(bench)
    Projection(draft.source).answered(bench)
    room = bench.builder(bench.scenario(draft.source)).cell
    assert bench._imager is not None
    imager = bench._imager[1]
    draft.set({"trajectory.latitude_amplitude_deg": 20})
    assert bench.builder(bench.scenario(draft.source)).cell is room
    draft.set({"cell.source_arm.base_position_mm": [860, 0, 0]})
    assert bench.builder(bench.scenario(draft.source)).cell is not room
    Projection(draft.source).answered(bench)
    assert bench._imager[1] is imager
    bench.close()
