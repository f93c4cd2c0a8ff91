"""Arms that are not as they are known: the simulation goes by the nominal, and tells the truth."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.geometry.wire import PosePairs, Reached
from twinct.robots.cell import CellModel, chains_of
from twinct.robots.motion import MotionPlan, RobotSimulation, Shutter
from twinct.scenario import Motion, Uncertainty
from twinct.uncertainty import TrueCell

AS_IN_THE_PAPER = Motion(scheme="planned", tool_speed_mm_s=125)
SHUTTER = Shutter(exposure_s=0.02, samples=2, remember=True)


@pytest.fixture
def true_cell(cell: CellModel) -> TrueCell:
    servos = {"source": {"resonance_hz": 9.0}, "detector": {"clock_ms": 2.0, "clock_ppm": 40.0}}
    keys = {"preset": "collaborative", "patient": {"nod_mm": 3}, "servos": servos}
    section = Uncertainty.model_validate(keys)
    return TrueCell(section, 1, 2, chains_of(cell))


def moved(simulation: RobotSimulation, targets: list[PosePairs], views: range) -> list[Reached]:
    return [simulation.move(view, targets[view]) for view in views]


def test_the_arms_do_what_they_did_and_are_elsewhere(
    cell: CellModel, plan: MotionPlan, targets: list[PosePairs], true_cell: TrueCell
) -> None:
    nominal = RobotSimulation(cell, AS_IN_THE_PAPER, plan, SHUTTER)
    real = RobotSimulation(cell, AS_IN_THE_PAPER, plan, SHUTTER, true_cell=true_cell)
    for one, other in zip(
        *(moved(each, targets, range(3)) for each in (nominal, real)), strict=True
    ):
        np.testing.assert_array_equal(one.state, other.state)
        assert other.executed.source[0].distance_mm(one.executed.source[0]) > 0.5
        assert other.executed.object != one.executed.object
        # In the middle of the exposure, between its instants.
        places = [source.position for source in other.exposure.source]
        middle = other.executed.source[0].position
        np.testing.assert_allclose(np.mean(places, axis=0), middle, atol=0.01)


def test_a_scan_goes_on_as_it_was(
    cell: CellModel, plan: MotionPlan, targets: list[PosePairs], true_cell: TrueCell
) -> None:
    """Executed poses are a function of the scenario, the view and the simulator's state."""
    first, second = (
        RobotSimulation(cell, AS_IN_THE_PAPER, plan, SHUTTER, true_cell=true_cell) for _ in range(2)
    )
    reached = moved(first, targets, range(3))
    second.restore(reached[1].state)
    (again,) = moved(second, targets, range(2, 3))
    assert again.executed == reached[2].executed
    assert again.exposure == reached[2].exposure
    assert again.before == reached[2].before


def test_what_lags_is_where_the_last_view_was_taken(
    cell: CellModel, plan: MotionPlan, targets: list[PosePairs], true_cell: TrueCell
) -> None:
    """With what was drawn for that view, not for this one."""
    shutter = Shutter(remember=True)
    simulation = RobotSimulation(cell, AS_IN_THE_PAPER, plan, shutter, true_cell=true_cell)
    first, second = moved(simulation, targets, range(2))
    assert second.before == first.executed
