"""Vibration of the joints and clocks of the controllers, against textbook answers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy

from twinct.core.errors import ScenarioError
from twinct.geometry import Floats, Pose
from twinct.geometry.wire import PosePairs
from twinct.robots.cell import CellModel, chains_of
from twinct.scenario import ArmServo, Uncertainty, parse_scenario
from twinct.uncertainty import TrueCell
from twinct.uncertainty.error_terms import ToolMotion
from twinct.uncertainty.nominal_scan import NominalScan
from twinct.uncertainty.terms.servo import bent

SERVO = ArmServo(resonance_hz=9.0, damping=0.03)
OMEGA = 2 * np.pi * 9.0
INTEGRAL = 0.002
"""Share of the amplitude by which the sum over past accelerations may differ from the integral."""


def motion(times: Floats, acceleration: Any) -> ToolMotion:
    none = np.zeros((len(times), 1))
    poses = np.tile(np.eye(4), (len(times), 1, 1))
    return ToolMotion("source", poses, times, None, none, none, acceleration)


def test_a_joint_rings_down_after_a_stop_as_an_oscillator_does() -> None:
    """Half a second of constant acceleration, against an integrator of ordinary equations."""

    def acceleration(times: Floats) -> Floats:
        return np.where((times > 0) & (times < 0.5), 5.0, 0.0)[:, None]

    def slope(t: float, state: Floats) -> list[float]:
        push = 5.0 if t < 0.5 else 0.0
        return [state[1], -push - 2 * 0.03 * OMEGA * state[1] - OMEGA**2 * state[0]]

    times = np.linspace(0.05, 1.99, 60)
    solved = [(0.0, 0.5), (0.5, 2.0)]
    start, truth = np.zeros(2), []
    for first, last in solved:  # the push ends within no step
        inside = times[(times > first) & (times <= last)]
        way = scipy.integrate.solve_ivp(
            slope, (first + 1e-12, last), start, t_eval=[*inside, last], rtol=1e-9, atol=1e-12
        )
        truth += way.y[0][: len(inside)].tolist()
        start = way.y[:, -1]
    found = bent(SERVO, motion(times, acceleration))[:, 0]
    most = np.abs(truth).max()
    assert most == pytest.approx(2 * 5.0 / OMEGA**2, rel=0.1)  # twice the bend at rest
    # A push whose end falls between two instants of the sum counts one of them too much.
    assert np.abs(found - truth).max() < 0.09 * most
    late = times > 1.5
    assert np.abs(found[late]).max() < np.exp(-0.03 * OMEGA) * most


def test_a_slow_acceleration_bends_by_its_share_of_the_stiffness() -> None:
    still = bent(SERVO, motion(np.array([3.0]), lambda times: np.full((len(times), 1), 2.0)))
    assert still[0, 0] == pytest.approx(-2.0 / OMEGA**2, rel=INTEGRAL)


@pytest.mark.parametrize("side", ["source", "detector"])
def test_each_arm_has_its_own_clock(cell: CellModel, side: str) -> None:
    """At constant speed, an arm whose clock is late stands where it was before."""
    asked = Uncertainty.model_validate({"servos": {side: {"clock_ms": 4.0, "clock_ppm": 50.0}}})
    chains, rng = chains_of(cell), np.random.default_rng(1)
    joints, speeds = rng.uniform(-1, 1, 12), rng.uniform(-0.5, 0.5, 12)
    time_s = 20.0
    late_s = 4e-3 + 50e-6 * time_s
    parts = slice(0, 6), slice(6, 12)
    poses = [chain.tools(joints[None, p])[0] for chain, p in zip(chains, parts, strict=True)]
    at = [Pose.from_matrix(pose[:3, 3], pose[:3, :3]) for pose in poses]
    true = TrueCell(asked, 1, 2, chains)
    real = true.at(PosePairs.at(at[0], at[1], Pose.identity()), 0, time_s, joints, speeds)
    for k, (chain, part) in enumerate(zip(chains, parts, strict=True)):
        moved = joints - late_s * speeds if k == ("source", "detector").index(side) else joints
        there = chain.tools(moved[None, part])[0]
        assert np.allclose(real[0][k].matrix, there, atol=1e-6)


def test_vibration_moves_what_is_executed_and_not_what_is_believed(cell: CellModel) -> None:
    """By the lever from joint to tool; without a plan, nothing vibrates."""
    asked = Uncertainty.model_validate({"servos": {"source": {"resonance_hz": 9.0}}})
    chains = chains_of(cell)
    joints = np.linspace(-1, 1, 12)[None]

    def accelerations(times: Floats) -> Floats:
        return np.tile(np.eye(12)[0], (len(times), 1))  # the first joint, 1 rad/s^2

    scan = NominalScan.of_arms(chains, joints, 0 * joints, np.array([5.0]), accelerations)
    poses = [Pose.from_matrix(m[0, :3, 3], m[0, :3, :3]) for m in scan.poses]
    nominal = PosePairs.at(poses[0], poses[1], Pose.identity())
    true = TrueCell(asked, 1, 2, chains)
    still = true.at(nominal, 0, 5.0, joints[0], 0 * joints[0])
    real = true.at(nominal, 0, 5.0, joints[0], 0 * joints[0], accelerations)
    assert still.source[0].distance_mm(poses[0]) < 1e-6
    assert real.detector[0].distance_mm(poses[1]) < 1e-6
    base = np.array(cell.cell.source_arm.base_position_mm)
    lever = np.linalg.norm((poses[0].position - base)[:2])
    assert real.source[0].distance_mm(poses[0]) == pytest.approx(lever / OMEGA**2, rel=0.01)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"motion": {"scheme": "reactive"}}, "follows from the plan"),
        ({"cell": {"kind": "gantry"}}, "a gantry has no arms"),
    ],
)
def test_machines_without_a_plan_are_refused(keys: dict[str, Any], message: str) -> None:
    data = {
        "trajectory": {"kind": "arc", "views": 4},
        "specimen": {"parts": [{"shape": {"kind": "sphere", "radius_mm": 20}}]},
        "uncertainty": {"servos": {"source": {"resonance_hz": 9.0}}},
    }
    parse_scenario(data)
    with pytest.raises(ScenarioError, match=message):
        parse_scenario(data | keys)
