"""The way of both arms to where they started, from wherever they are."""

from __future__ import annotations

import numpy as np

from twinct.cell import CellModel, Clearance
from twinct.errors import TrajectoryError
from twinct.geometry import Floats
from twinct.motion.detour import SEARCHES, Detours
from twinct.motion.feasible import SHORTFALL_MM, Feasible
from twinct.motion.kinematics import mujoco, site_pose
from twinct.motion.refusals import gap_text
from twinct.motion.way import Way, kept_mm
from twinct.scenario import Motion
from twinct.views import Target

AT_ONCE = 8
"""Knots of the way back that are looked for at once, the last ones first."""


def way_home(
    cell: CellModel,
    motion: Motion,
    start: Floats,
    home: Floats,
    back: Floats,
    *,
    seed: int = 0,
    most_looks: float = np.inf,
) -> Way:
    """Straight in joint space where that is clear; else back as the arms came; else a way round.

    Args:
        cell: the room.
        motion: the clearance asked for; where an end of the way has less, that is kept instead.
        start: where the arms are, rad, (n,).
        home: where they shall be, rad, (n,).
        back: knots of a clear way from start to home, both included, which is shortened where
            straight ways between its knots are clear, rad, (m, n); empty: none is known.
        seed: of the searches.
        most_looks: configurations that the searches may look at.

    Returns:
        A way with one view, at its end: the poses that the arms have at home.

    Raises:
        TrajectoryError: bodies touch where the arms are, or no way was found.
    """
    least = kept_mm(motion)
    gap = Clearance(cell).over(np.array([start, home]))
    kept = min(least, gap.distance_mm - 2 * SHORTFALL_MM)
    if kept <= 0:
        raise TrajectoryError(f"start: {gap_text(gap, least)}")
    room, knots = Feasible(cell), np.array([start, home])
    if not room.straight(knots[:1], knots[1:], kept)[0]:
        if len(back):
            knots = _shortened(room, back, kept)
        else:
            # All joints end as told: home is one turn, not the next.
            detours = Detours(cell, room, np.zeros(len(start), bool), seed, most_looks)
            tries = (detours.between(start, home, kept, k) for k in range(len(SEARCHES)))
            found = next((way for way in tries if way is not None), None)
            if found is None:
                raise TrajectoryError(f"no way home was found, {detours.looked} ones looked at")
            knots = found
    data = mujoco.MjData(cell.model)
    data.qpos[:] = home
    mujoco.mj_kinematics(cell.model, data)
    target = Target.from_poses(*(site_pose(data, site) for site in cell.site_ids))
    return Way(knots, np.append(np.full(len(knots) - 1, -1), 0), (target,))


def _shortened(room: Feasible, knots: Floats, least_mm: float) -> Floats:
    """From each knot straight to the last one that is in sight; the next one always is."""
    kept, last = [0], len(knots) - 1
    while kept[-1] < last:
        here = kept[-1]
        following = here + 1
        for stop in range(last + 1, here + 2, -AT_ONCE):
            ends = knots[max(stop - AT_ONCE, here + 2) : stop]
            seen = room.straight(np.broadcast_to(knots[here], ends.shape), ends, least_mm)
            if seen.any():
                following = stop - len(ends) + int(np.flatnonzero(seen)[-1])
                break
        kept.append(following)
    return knots[kept]
