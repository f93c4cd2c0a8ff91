"""Path of the reactive scheme: one branch of each arm, followed from view to view.

Each arm reaches a pose on several branches (elbow up or down, wrist turned over). All branches that
seeded restarts find in the middle of the path are followed to both ends. The pair that reaches
every view with the largest clearance is chosen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twinct.core.errors import TrajectoryError
from twinct.geometry import MM_PER_M, Floats
from twinct.geometry.wire import PosePairs
from twinct.robots.cell import CellModel, Clearance, Gap, mujoco
from twinct.robots.motion.branches import SIDES
from twinct.robots.motion.home import FLIP_RAD, home_off
from twinct.robots.motion.kinematics import Kinematics
from twinct.robots.motion.path_search import JointPath
from twinct.robots.motion.refusals import far_problems, gap_problems, named, runs
from twinct.robots.sections import Motion

RESTARTS = 60
"""Random starts in one view; two UR10e show all their branches within 40."""

BRANCHES = 16
"""Largest number of branches of one arm that are followed."""

SAME_RAD = 0.05
"""Configurations closer than this in every joint belong to one branch."""

CHECK_MM = 4.0
"""Travel of a geom between two clearance checks from view to view."""


@dataclass(frozen=True, eq=False)
class _JointPath:
    """One arm's path on one branch: joints (views, k), residual errors and flips (views,)."""

    joints: Floats
    position_mm: Floats
    rotation_deg: Floats
    solved: np.ndarray
    flips: np.ndarray

    @property
    def good(self) -> bool:
        return bool(self.solved.all() and not self.flips.any())

    @property
    def badness(self) -> tuple[int, float]:
        return int((~self.solved).sum() + self.flips.sum()), float(self.position_mm.max())


def branch_path(cell_model: CellModel, motion: Motion, targets: Sequence[PosePairs]) -> JointPath:
    """Find a path through all targets on one branch of each arm.

    Args:
        cell_model: robot cell.
        motion: tolerances and the required clearance.
        targets: one for each view, in order.

    Raises:
        TrajectoryError: views are out of reach, in collision or without a continuous path; every
            problem names views, arm, reason and missing distance.
        MissingExtraError: mink is not installed.
    """
    targets = list(targets)
    kinematics = Kinematics(cell_model, motion.ik)
    ways = _ways(cell_model, kinematics, targets)
    problems = []
    for side, paths in zip(SIDES, ways, strict=True):
        if not any(way.good for way in paths):
            problems += _reach_problems(side, min(paths, key=lambda way: way.badness))
    if problems:
        raise TrajectoryError(problems)
    pair = _clearest(cell_model, [[w for w in paths if w.good] for paths in ways])
    joints = np.hstack([way.joints for way in pair])
    gaps = gaps_along(cell_model, joints)
    required_mm = motion.clearance_mm
    close = {view: gap for view, gap in enumerate(gaps) if gap.distance_mm < required_mm}
    if close:
        raise TrajectoryError(gap_problems(close, required_mm))
    clearance, scratch = Clearance(cell_model), mujoco.MjData(cell_model.model)

    def clear(home: Floats) -> bool:
        path = straight_path(cell_model, scratch, joints[0], home)
        return clearance.over(path).distance_mm >= required_mm

    home = home_off(targets[0], joints[0], kinematics, clear, required_mm)
    return JointPath(np.vstack([home, joints]), np.arange(-1, len(joints)), tuple(targets))


def _ways(
    cell: CellModel, kinematics: Kinematics, targets: list[PosePairs]
) -> tuple[list[_JointPath], list[_JointPath]]:
    """Return both arms' paths on every detected branch, with both arms solved together."""
    middle, starts = _start_view(cell, kinematics, targets)
    ways: tuple[list[_JointPath], list[_JointPath]] = ([], [])
    for k in range(max(len(result) for result in starts)):
        start = np.hstack([result[min(k, len(result) - 1)] for result in starts])
        traced = _trace(cell, kinematics, targets, middle, start)
        for arm in range(2):
            if k < len(starts[arm]):
                ways[arm].append(traced[arm])
    return ways


def _start_view(
    cell: CellModel, kinematics: Kinematics, targets: list[PosePairs]
) -> tuple[int, list[list[Floats]]]:
    """Return a view that both arms reach, the middle view if possible, and their branches there."""
    last = len(targets) - 1
    result = None
    for view in dict.fromkeys((len(targets) // 2, 0, last, last // 4, 3 * last // 4)):
        starts, reached = _starts(cell, kinematics, targets[view])
        if result is None or reached > result[2]:
            result = (view, starts, reached)
        if reached == 2:
            break
    assert result is not None
    return result[:2]


def _starts(
    cell: CellModel, kinematics: Kinematics, target: PosePairs
) -> tuple[list[list[Floats]], int]:
    """Return each arm's branches at a target, or its nearest miss, and the number of arms there."""
    rng = np.random.default_rng(0)
    low = np.maximum(cell.joint_ranges[:, 0], -np.pi)
    high = np.minimum(cell.joint_ranges[:, 1], np.pi)
    by_arm: list[list[Floats]] = [[], []]
    nearest: list[tuple[float, Floats]] = [(np.inf, np.zeros(0))] * 2
    for k in range(RESTARTS):
        start = rng.uniform(low, high)
        for joints, home in zip(cell.arm_joints, cell.homes, strict=True):
            if k == 0 and home is not None:
                start[joints] = home
        result = kinematics.solve(start, target)
        for arm, joints in enumerate(cell.arm_joints):
            q = _wrapped(result.joints[joints], cell.joint_ranges[joints])
            if result.position_mm[arm] < nearest[arm][0]:
                nearest[arm] = (float(result.position_mm[arm]), q)
            known = any(np.abs(q - other).max() < SAME_RAD for other in by_arm[arm])
            if result.solved[arm] and not known and len(by_arm[arm]) < BRANCHES:
                by_arm[arm].append(q)
    starts = [ways or [nearest[arm][1]] for arm, ways in enumerate(by_arm)]
    return starts, sum(bool(ways) for ways in by_arm)


def _wrapped(joints: Floats, ranges: Floats) -> Floats:
    """Remove full turns from joints where the result lies within their ranges."""
    wrapped = (joints + np.pi) % (2 * np.pi) - np.pi
    return np.where((wrapped >= ranges[:, 0]) & (wrapped <= ranges[:, 1]), wrapped, joints)


def _trace(
    cell: CellModel, kinematics: Kinematics, targets: list[PosePairs], middle: int, start: Floats
) -> list[_JointPath]:
    views = len(targets)
    joints = np.zeros((views, len(start)))
    position, rotation = np.zeros((views, 2)), np.zeros((views, 2))
    solved, flips = np.zeros((views, 2), bool), np.zeros((views, 2), bool)
    for order in (range(middle, views), range(middle - 1, -1, -1)):
        q = start if order.step > 0 else joints[middle]
        for view in order:
            result, largest = kinematics.follow(q, targets[view])
            if view != middle:
                for arm, part in enumerate(cell.arm_joints):
                    flips[view, arm] = largest[part].max() > FLIP_RAD
            joints[view] = result.joints
            # An arm continues from its last solution, not from where it got stuck.
            q = q.copy()
            for arm, part in enumerate(cell.arm_joints):
                if result.solved[arm]:
                    q[part] = result.joints[part]
            position[view], rotation[view] = result.position_mm, result.rotation_deg
            solved[view] = result.solved
    joints = _centred(joints, cell.joint_ranges)
    return [
        _JointPath(joints[:, part], position[:, a], rotation[:, a], solved[:, a], flips[:, a])
        for a, part in enumerate(cell.arm_joints)
    ]


def _centred(joints: Floats, ranges: Floats) -> Floats:
    """Shift a path by full turns so that it stays as far as possible from the joint limits."""
    turns = 2 * np.pi * np.arange(-2, 3)[:, None]
    margin = np.minimum(
        joints.min(axis=0) + turns - ranges[:, 0], ranges[:, 1] - joints.max(axis=0) - turns
    )
    # Prefer the smallest shift among equals, so that a centred path stays in place.
    best = np.argmax(np.round(margin, 6) - 1e-9 * np.abs(turns), axis=0)
    return joints + turns[best, 0]


def _clearest(cell: CellModel, ways: list[list[_JointPath]]) -> tuple[_JointPath, _JointPath]:
    """Return the pair of paths with the largest clearance, evaluated in up to 40 views."""
    views = len(ways[0][0].joints)
    sample = np.unique(np.linspace(0, views - 1, min(views, 40)).astype(int))
    data = mujoco.MjData(cell.model)

    def smallest_gap(clearance: Clearance, part: slice, joints: Floats, enough: float) -> float:
        """Return the smallest gap over the sample; stop once it is below ``enough``."""
        smallest = np.inf
        for view in sample:
            data.qpos[part] = joints[view]
            mujoco.mj_kinematics(cell.model, data)
            smallest = min(smallest, clearance.at(data).distance_mm)
            if smallest < enough:
                break
        return smallest

    alone = []
    for side, part, paths in zip(SIDES, cell.arm_joints, ways, strict=True):
        clearance = Clearance(cell, (side,))
        alone.append([smallest_gap(clearance, part, way.joints, -np.inf) for way in paths])
    pairs = [
        (min(a, b), one, other)
        for a, one in zip(alone[0], ways[0], strict=True)
        for b, other in zip(alone[1], ways[1], strict=True)
    ]
    pairs.sort(key=lambda pair: -pair[0])
    clearance = Clearance(cell)
    best, best_score = pairs[0][1:], (-np.inf, -np.inf)
    for bound, *pair in pairs:
        if bound < best_score[0]:
            break
        joints = np.hstack([way.joints for way in pair])
        smallest = smallest_gap(clearance, slice(None), joints, best_score[0])
        # At equal clearance (within a wrist, for example), prefer less joint motion.
        travel = sum(np.abs(np.diff(way.joints, axis=0)).sum() for way in pair)
        if (smallest, -travel) > best_score:
            best, best_score = pair, (smallest, -travel)
    return best[0], best[1]


def gaps_along(cell: CellModel, joints: Floats) -> list[Gap]:
    """Return the smallest gap at each view and on the straight joint path from the view before."""
    clearance = Clearance(cell)
    scratch = mujoco.MjData(cell.model)
    return [
        clearance.over(straight_path(cell, scratch, joints[max(view - 1, 0)], end))
        for view, end in enumerate(joints)
    ]


def straight_path(cell: CellModel, data: mujoco.MjData, start: Floats, end: Floats) -> Floats:
    """Return configurations from ``end`` back towards ``start``, in steps of at most CHECK_MM.

    The start is excluded: it is the current position, or the end of the previous path.

    Args:
        cell: robot cell.
        data: scratch data.
        start: joint positions, rad, (n,).
        end: joint positions, rad, (n,), the first row of the result, (steps, n).
    """
    places = []
    for joints in (start, end):
        data.qpos[:] = joints
        mujoco.mj_kinematics(cell.model, data)
        places.append(data.geom_xpos.copy())
    moved_mm = float(np.linalg.norm(places[1] - places[0], axis=1).max()) * MM_PER_M
    steps = max(1, int(np.ceil(moved_mm / CHECK_MM)))
    share = np.arange(steps, 0, -1)[:, None] / steps
    return start + share * (end - start)


def _reach_problems(side: str, way: _JointPath) -> list[str]:
    off = zip(way.position_mm.tolist(), way.rotation_deg.tolist(), strict=True)
    problems = far_problems(side, {v: d for v, d in enumerate(off) if not way.solved[v]})
    for first, last in runs(np.flatnonzero(way.flips & way.solved).tolist()):
        problems.append(
            f"{named(first, last)}: {side} arm: no continuous path from the neighbouring view; a "
            f"joint would jump by more than {np.degrees(FLIP_RAD):.0f} deg"
        )
    return problems
