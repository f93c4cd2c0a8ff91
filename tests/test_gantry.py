"""A gantry is where it is told, to the last bit, and goes on from its state."""

from __future__ import annotations

import math

import numpy as np
import pytest

from twinct.core.errors import MotionError
from twinct.geometry import Panel, Pose
from twinct.geometry.wire import PosePairs, Reached, targets_of
from twinct.robots.gantry import Gantry
from twinct.scenario import GantryCell, Source, parse_scenario
from twinct.trajectory import commanded_views

STANDS = Pose.from_euler((1, 2, 3), (10, 20, 30))
ON_THE_WAY_MM = 1e-9
"""An instant is off its circle or helix by the rounding of a few products of 300 mm."""


def targets(**trajectory: object) -> list[PosePairs]:
    specimen = {"parts": [{"shape": {"kind": "sphere", "radius_mm": 1}}]}
    scenario = parse_scenario({"trajectory": trajectory, "specimen": specimen})
    geometry = commanded_views(scenario.trajectory, Panel(4, 5, 1.0, 1.0))
    return targets_of(geometry)


def gantry(samples: int = 1, exposure_ms: float = 10.0, view_s: float = 2.0) -> Gantry:
    source = Source(motion_samples=samples, exposure_ms=exposure_ms)
    return Gantry(GantryCell(kind="gantry", view_s=view_s), source, STANDS, remember=samples > 1)


def test_executed_is_commanded_to_the_last_bit_all_the_way_round() -> None:
    machine, circle = gantry(), targets(kind="circle", views=360)
    # Others may send any metres; of these, one in twenty changes on its way to mm and back.
    metres = np.random.default_rng(1).uniform(-1, 1, (20, 2, 3)).tolist()
    turned = STANDS.quat.tolist()
    foreign = [PosePairs.from_sevens([[[*at, *turned] for at in pair]]) for pair in metres]
    for number, target in enumerate([*circle, *foreign]):
        reached = machine.move(number, target)
        assert reached.executed.source[0].seven == target.source[0].seven
        assert reached.executed.detector[0].seven == target.detector[0].seven
        assert reached.executed.object == (Pose.from_metres(*STANDS.to_metres()),)
        assert reached.path == reached.executed and reached.before is None
        assert reached.time_s == 2.0 * (number + 1)
        assert reached.joint_names == () and reached.position.shape == (0,)
        assert math.isnan(reached.clearance_mm) and reached.clearance_in_words.endswith("unknown")


@pytest.mark.parametrize("pitch_mm", [0.0, 40.0])
def test_an_exposure_goes_on_along_the_path_with_its_middle_at_the_view(pitch_mm: float) -> None:
    way = targets(kind="helix", views=25, turns=1, pitch_mm=pitch_mm)
    machine = gantry(samples=4, exposure_ms=1000.0)
    first = machine.move(0, way[0])
    for pose in first.exposure.source:
        np.testing.assert_allclose(pose.seven, way[0].source[0].seven, atol=1e-12)
    reached = machine.move(1, way[1])
    assert reached.before == first.executed
    # Half of the 2 s of a view, in four parts, of steps of 15 degrees from the middle of a turn.
    degrees = -180 + 15 + 7.5 * np.array([-0.375, -0.125, 0.125, 0.375])
    for (source, panel), angle in zip(reached.exposure, degrees, strict=True):
        turn, height = np.radians(angle), pitch_mm * angle / 360
        out = np.array([np.cos(turn), np.sin(turn), 0.0])
        expected = 300 * out + (0, 0, height), -300 * out + (0, 0, height)
        np.testing.assert_allclose(source.position, expected[0], atol=ON_THE_WAY_MM)
        np.testing.assert_allclose(panel.position, expected[1], atol=ON_THE_WAY_MM)
        np.testing.assert_allclose(panel.rotation[:, 2], out, atol=1e-12)


def test_it_goes_on_from_a_state_bit_by_bit() -> None:
    way = targets(kind="circle", views=7)
    straight = gantry(samples=3, view_s=0.1)
    seen = [straight.move(view, target) for view, target in enumerate(way)]
    again = gantry(samples=3, view_s=0.1)
    again.restore(seen[2].state)
    for view in range(3, len(way)):
        assert numbers(again.move(view, way[view])) == numbers(seen[view])


def numbers(reached: Reached) -> tuple[object, ...]:
    more = reached.time_s, reached.exposure, reached.before
    return reached.executed, reached.state.tobytes(), *more


def test_a_state_of_arms_is_refused() -> None:
    with pytest.raises(MotionError, match=r"\(31,\), but the states of a gantry have \(15,\)"):
        gantry().restore(np.zeros(31))
