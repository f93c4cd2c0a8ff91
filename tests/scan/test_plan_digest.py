"""A plan's own key: it covers what the plan reads, and nothing else makes plans anew."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from twinct.core.settings import Section
from twinct.scan import SimulationBuilder
from twinct.scenario import Scenario, load_scenario
from twinct.scenario.digests import declared, readers

DEMO = Path(__file__).parents[2] / "scenarios" / "demo.yaml"
FEW = "trajectory.views=2", "cell.timestep_ms=4"
ERRORS = "uncertainty.arms.tool_mm=0.2", "uncertainty.views.source_mm=0.1"


def digest(*overrides: str) -> str:
    return SimulationBuilder(load_scenario(DEMO, overrides)).plan_digest


@pytest.mark.parametrize(
    "override",
    [
        "seed=5",
        "uncertainty.seed=5",
        "uncertainty.arms.seed=5",
        "uncertainty.arms.tool_mm=0.3",
        "uncertainty.patient.nod_mm=2",
        "uncertainty.preset=collaborative",
        "uncertainty.encoder_step_deg=0.01",
        "motion.settle_speed_mm_s=0.1",
        "motion.settle_s=0.4",
        "source.energy_kev=70",
        "detector.lag=0.1",
        "specimen.parts.0.material=water",
        "reconstruction.iterations=3",
    ],
)
def test_scans_that_differ_elsewhere_share_a_plan(override: str) -> None:
    assert digest(*ERRORS, override) == digest(*ERRORS)


@pytest.mark.parametrize(
    "override",
    [
        "trajectory.views=9",
        "specimen.parts.0.shape.scale=1.1",
        "specimen.rotation_deg=[0, 0, 9]",
        "specimen.safety_mm=3",
        "cell.source_arm.model=lbr_iiwa14",
        "cell.detector_arm.tool_mass_kg=5",
        "cell.table.present=false",
        "cell.timestep_ms=1",
        "motion.ik.max_iterations=300",
        "motion.trigger=settled",
        "motion.tolerance_mm=0.5",
        "motion.timeout_s=5",
        "motion.jerk_deg_s3=4000",
        "detector.frame_ms=90",
        "source.exposure_ms=20",
        "source.motion_samples=3",
        "detector.columns=320",
    ],
)
def test_scans_that_differ_in_what_a_plan_reads_do_not(override: str) -> None:
    assert digest(*ERRORS, override) != digest(*ERRORS)


def test_the_speed_and_time_of_rest_count_where_the_plan_waits_for_it() -> None:
    settled, slower = "motion.trigger=settled", "motion.settle_speed_mm_s=0.1"
    assert digest(settled, slower) != digest(settled)
    assert digest(settled, "motion.settle_s=0.4") != digest(settled)


def test_a_focal_spot_counts_where_it_decides_whether_the_source_may_roll() -> None:
    square = "source.focal_spot={kind: square, size_mm: 0.5}"
    fixed, free = "motion.detector_roll=fixed", "motion.detector_roll=free"
    assert digest(fixed, square) == digest(fixed)
    assert digest(free, square) != digest(free)


def sections(value: object, key: str = "") -> Iterator[tuple[str, Section]]:
    """The sections of a scenario, with their keys."""
    if isinstance(value, Section):
        yield key, value
        for name in type(value).model_fields:
            yield from sections(getattr(value, name), f"{key}.{name}" if key else name)
    elif isinstance(value, tuple):
        for one in value:
            yield from sections(one, key)


ELSEWHERE = {"source.focal_spot", "detector.lag"}
"""Keys that planning reads: the first counts by ``roll_free``, the other does not change a plan
(``Shutter.remember``)."""


@pytest.mark.parametrize("trigger", ["on_entry", "settled"])
def test_planning_reads_no_key_that_the_digest_leaves_out(
    trigger: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = load_scenario(DEMO, [*FEW, *ERRORS, f"motion.trigger={trigger}"])
    by_id = {id(section): key for key, section in sections(scenario)}
    read = set[str]()
    plain = Section.__getattribute__

    def noted(self: Section, name: str) -> object:
        if (key := by_id.get(id(self))) is not None and name in type(self).model_fields:
            read.add(f"{key}.{name}" if key else name)
        return plain(self, name)

    builder = SimulationBuilder(scenario)
    assert builder.specimen  # its own key is that of the stage "surface"
    monkeypatch.setattr(Section, "__getattribute__", noted)
    assert builder.plan is not None
    monkeypatch.undo()
    declaring = {key for key, _ in declared(Scenario)}
    keys = {key for key in read if not any(one.startswith(f"{key}.") for one in declaring)}
    counted = {key for key in keys if {*readers(key)} & {"surface", "plan", "executed"}}
    assert {"motion.jerk_deg_s3", "motion.ik.max_iterations", "source.exposure_ms"} <= counted
    assert keys - counted == ELSEWHERE
    # The two that ``plan_digest`` leaves out, although the executed poses depend on them:
    assert not {key for key in read if key.startswith(("uncertainty", "seed"))}
    assert ("motion.settle_speed_mm_s" in read) == (trigger == "settled")
