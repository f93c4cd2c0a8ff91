"""Servos that a scenario chooses for each arm: lag without feedforward, and none with it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import trimesh

from twinct.geometry import Floats, Pose
from twinct.geometry.wire import PosePairs
from twinct.robots.cell import CellModel, build_cell
from twinct.robots.motion import MotionPlan, RobotSimulation
from twinct.scenario import Detector, Motion, Servo

MOVING = Motion(scheme="planned", tolerance_mm=30.0)
"""An arm that lags is not where the other one is: a small tolerance would miss the views."""
STEP_S = 0.002
"""Step of the simulation, ``cell.timestep_ms``."""

SERIES = 0.12
"""Share of the lag by which the fit may be wrong: a series in four derivatives of the reference,
whose moves last ten time constants of the slow servo."""


def with_servo(cell: CellModel, head: trimesh.Trimesh, **keys: float) -> CellModel:
    arm = cell.cell.source_arm.model_copy(update={"servo": Servo(**keys)})
    section = cell.cell.model_copy(update={"source_arm": arm})
    return build_cell(section, head, Pose.identity(), Detector().panel)


def followed(
    cell: CellModel, plan: MotionPlan, targets: list[PosePairs]
) -> tuple[Floats, Floats, Floats]:
    """Return deviation, speed and acceleration of all joints at every step of the first views."""
    rows: list[Floats] = []
    n = len(cell.joint_names)

    def keep(data: Any) -> None:
        rows.append(np.concatenate([data.userdata[: 3 * n], data.qpos]))

    simulation = RobotSimulation(cell, MOVING, plan)
    for view in range(4):
        simulation.move(view, targets[view], keep)
    table = np.array(rows).reshape(len(rows), 4, n)
    return table[:, 0] - table[:, 3], table[:, 1], table[:, 2]


@pytest.mark.parametrize(("bandwidth", "feedforward"), [(80.0, 0.0), (40.0, 0.0), (40.0, 0.5)])
def test_a_joint_lags_by_two_over_the_bandwidth(
    cell: CellModel,
    head: trimesh.Trimesh,
    plan: MotionPlan,
    targets: list[PosePairs],
    bandwidth: float,
    feedforward: float,
) -> None:
    slow = with_servo(cell, head, bandwidth_rad_s=bandwidth, feedforward=feedforward)
    deviation, speed, acceleration = followed(slow, plan, targets)
    lags = []
    for joint in range(12):
        jerk = np.gradient(acceleration[:, joint], STEP_S)
        more = np.gradient(jerk, STEP_S)
        terms = np.stack([speed[:, joint], acceleration[:, joint], jerk, more], axis=1)
        # The reference that is kept is that of the step before.
        lags.append(np.linalg.lstsq(terms, deviation[:, joint], rcond=None)[0][0] + STEP_S)
    fast = np.abs(speed).max(axis=0) > 0.05
    late_s = np.array(lags)[:6][fast[:6]]
    assert len(late_s) >= 3
    assert np.median(late_s) == pytest.approx((1 - feedforward) * 2 / bandwidth, rel=SERIES)
    assert np.median(np.abs(np.array(lags)[6:][fast[6:]])) < 1e-4


def test_the_default_follows_as_before(
    cell: CellModel, head: trimesh.Trimesh, plan: MotionPlan, targets: list[PosePairs]
) -> None:
    """To the last bit: a scenario that states the default has the results of one that does not."""
    same = with_servo(cell, head, bandwidth_rad_s=80.0, feedforward=1.0)
    for one, other in zip(
        followed(cell, plan, targets), followed(same, plan, targets), strict=True
    ):
        assert np.array_equal(one, other)
