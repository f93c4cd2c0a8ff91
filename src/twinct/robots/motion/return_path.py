"""Path of both arms from their current joints back to their home."""

from __future__ import annotations

import numpy as np

from twinct.core.errors import TrajectoryError
from twinct.geometry import Floats
from twinct.geometry.wire import PosePairs
from twinct.robots.cell import CellModel, Clearance, mujoco
from twinct.robots.motion.feasible import SHORTFALL_MM, Feasible
from twinct.robots.motion.kinematics import site_pose
from twinct.robots.motion.path_planner import SEARCHES, Detours
from twinct.robots.motion.path_search import JointPath, required_gap_mm
from twinct.robots.motion.refusals import gap_text
from twinct.robots.sections import Motion

AT_ONCE = 8
"""Knots of the path back that are checked at once for a straight connection, last ones first."""


def path_home(
    cell: CellModel,
    motion: Motion,
    start: Floats,
    home: Floats,
    back: Floats,
    *,
    seed: int = 0,
    most_looks: float = np.inf,
) -> JointPath:
    """Find a path home: straight in joint space, else along the known path, else by a detour.

    Args:
        cell: robot cell.
        motion: required clearance; the path keeps less if one of its ends has less.
        start: current joint positions, rad, (n,).
        home: joint positions at home, rad, (n,).
        back: knots of a clear path from start to home, both included, rad, (m, n); shortened where
            straight paths between its knots are clear. Empty if no path is known.
        seed: seed of the searches.
        most_looks: largest number of configurations that the searches may check.

    Returns:
        a path with one view, at its end: the poses of the end-effectors at home.

    Raises:
        TrajectoryError: bodies touch at the start or at home, or no path was found.
    """
    least = required_gap_mm(motion)
    gap = Clearance(cell).over(np.array([start, home]))
    clearance = min(least, gap.distance_mm - 2 * SHORTFALL_MM)
    if clearance <= 0:
        raise TrajectoryError(f"start: {gap_text(gap, least)}")
    room, knots = Feasible(cell), np.array([start, home])
    if not room.straight(knots[:1], knots[1:], clearance)[0]:
        if len(back):
            knots = _shortened(room, back, clearance)
        else:
            # No free turns: all joints must end exactly at home, not a turn away.
            detours = Detours(cell, room, np.zeros(len(start), bool), seed, most_looks)
            tries = (detours.between(start, home, clearance, k) for k in range(len(SEARCHES)))
            path = next((way for way in tries if way is not None), None)
            if path is None:
                raise TrajectoryError(
                    f"no path home found after checking {detours.looked} configurations"
                )
            knots = path
    data = mujoco.MjData(cell.model)
    data.qpos[:] = home
    mujoco.mj_kinematics(cell.model, data)
    target = PosePairs.at(*(site_pose(data, site) for site in cell.site_ids))
    return JointPath(knots, np.append(np.full(len(knots) - 1, -1), 0), (target,))


def _shortened(room: Feasible, knots: Floats, least_mm: float) -> Floats:
    """Connect each knot straight to the last knot in sight, at least to the next one."""
    knot_numbers, last = [0], len(knots) - 1
    while knot_numbers[-1] < last:
        here = knot_numbers[-1]
        following = here + 1
        for stop in range(last + 1, here + 2, -AT_ONCE):
            ends = knots[max(stop - AT_ONCE, here + 2) : stop]
            seen = room.straight(np.broadcast_to(knots[here], ends.shape), ends, least_mm)
            if seen.any():
                following = stop - len(ends) + int(np.flatnonzero(seen)[-1])
                break
        knot_numbers.append(following)
    return knots[knot_numbers]
