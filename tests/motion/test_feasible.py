"""Judgements of clearance against Coal's distances of all pairs, and densely sampled paths."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from coal_distances import CoalDistances

from twinct.robots.cell import CellModel, Clearance
from twinct.robots.motion import MotionPlan
from twinct.robots.motion.feasible import SHORTFALL_MM, Feasible

ASKED_MM = 10.5


def pairs_of(cell: CellModel, arms: set[int]) -> list[list[int]]:
    """Pairs of geoms that involve these moving arms and no other."""
    bodies = cell.model.geom_bodyid[cell.pairs]
    moved = np.array([cell.lever[bodies, part].any(axis=(1, 2)) for part in cell.arm_joints])
    return cell.pairs[[{k for k in (0, 1) if m[k]} <= arms for m in moved.T]].tolist()


@pytest.mark.parametrize(("whom", "arms"), [("source", {0}), ("detector", {1}), ("both", {0, 1})])
def test_configurations_are_judged_as_unpruned_distances_say(
    cell: CellModel, whom: str, arms: set[int]
) -> None:
    joints = np.random.default_rng(3).uniform(-np.pi, np.pi, (80, 12))
    clear = Feasible(cell, whom).clear(joints, ASKED_MM)  # type: ignore[arg-type]
    assert 10 < clear.sum() < 70
    data, referee = mujoco.MjData(cell.model), CoalDistances(cell.model)
    pairs = np.array(pairs_of(cell, arms))
    for q, verdict in zip(joints, clear, strict=True):
        data.qpos[:] = q
        mujoco.mj_kinematics(cell.model, data)
        gap_mm = referee.smallest(data, pairs) * 1000
        assert verdict == (gap_mm >= ASKED_MM), gap_mm


def test_one_arm_with_the_other_is_what_is_left(cell: CellModel, plan: MotionPlan) -> None:
    joints = plan.joints[0] + np.random.default_rng(4).uniform(-1, 1, (300, 12))
    parts = [
        Feasible(cell, whom).clear(joints, ASKED_MM) for whom in ("source", "detector", "cross")
    ]
    assert np.array_equal(np.all(parts, axis=0), Feasible(cell).clear(joints, ASKED_MM))
    assert not parts[2].all()


def test_straight_paths_are_judged_as_dense_samples_say(cell: CellModel) -> None:
    rng = np.random.default_rng(5)
    joints = rng.uniform(-np.pi, np.pi, (400, 12))
    starts = joints[Feasible(cell).clear(joints, ASKED_MM)][:40]
    ends = starts + rng.uniform(-0.4, 0.4, starts.shape)
    clear = Feasible(cell).straight(starts, ends, ASKED_MM)
    assert 5 < clear.sum() < 35
    clearance, shares = Clearance(cell), np.linspace(0, 1, 200)[:, None]
    for a, b, verdict in zip(starts, ends, clear, strict=True):
        gap = clearance.over(a + shares * (b - a)).distance_mm
        # Between samples less may pass: a no needs a gap that they may just miss.
        assert gap >= ASKED_MM - SHORTFALL_MM if verdict else gap < ASKED_MM + 0.5


def test_a_verdict_does_not_depend_on_its_neighbours(cell: CellModel) -> None:
    rng = np.random.default_rng(6)
    joints = rng.uniform(-np.pi, np.pi, (130, 12))
    room = Feasible(cell)
    ends = joints + 0.1
    assert np.array_equal(room.clear(joints[77:90], ASKED_MM), room.clear(joints, ASKED_MM)[77:90])
    assert np.array_equal(
        room.straight(joints[77:90], ends[77:90], ASKED_MM),
        room.straight(joints, ends, ASKED_MM)[77:90],
    )
