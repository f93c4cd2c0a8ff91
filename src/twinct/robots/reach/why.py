"""Diagnosis of infeasible views: the reason, a change that cures it, and the closest attempt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twinct.core.progress import SILENT, Progress
from twinct.geometry import Floats, Pose
from twinct.geometry.wire import PosePairs
from twinct.robots.cell import CellModel, Clearance, Gap, Marks
from twinct.robots.motion import Kinematics
from twinct.robots.motion.branches import SIDES
from twinct.robots.motion.refusals import far_problems, gap_text, weak_text
from twinct.robots.reach.cures import CureSearch
from twinct.robots.reach.holding import Holder, TargetPoses

STARTS = 8
"""Random starts of the search for an arm's configuration nearest to a pose."""

WIDEST_OF = 64
"""Largest number of pairs of configurations among which the largest clearance is sought."""


@dataclass(frozen=True, eq=False)
class HeldView:
    """One view, held as well as the arms can.

    Attributes:
        joints: joint configuration that holds the view or comes nearest to it, rad, (n,).
        marks: marks of the problems: red bodies that are too close, and ghosts of tools at target
            poses out of reach.
        words: the problems, one sentence each; empty if both arms hold the view.
    """

    joints: Floats
    marks: Marks
    words: tuple[str, ...]


def shown(holder: Holder, poses: TargetPoses, view: int) -> HeldView:
    """Return the configuration of both arms closest to a view, and its problems.

    Args:
        holder: feasibility checks of the cell, with their setting of the roll.
        poses: poses of all views.
        view: index of the view.
    """
    one, both = poses[[view]], (poses.source[view], poses.detector[view])
    alone = holder.alone(one.source, 0), holder.alone(one.detector, 1)
    pairs = holder.pairs(*alone, 0)
    if len(pairs):
        return HeldView(pairs[0], Marks(), ())
    options, ghosts, words = [], [], []
    for arm, matrix in enumerate(both):
        joints = alone[arm].joints
        if not len(joints):
            joints = holder.any_clearance(matrix[None], arm).joints
        if not len(joints):
            joints, off = _nearest(holder, both, arm)
            words += [
                f"view {view}: {p.partition(': ')[2]}"
                for p in far_problems(SIDES[arm], {view: off})
            ]
            ghosts.append((SIDES[arm], Pose.from_matrix(matrix[:3, 3], matrix[:3, :3])))
        options.append(joints)
    joints, gap = _widest(holder.cell, options)
    red = ()
    if gap.distance_mm < holder.least_mm and not ghosts:
        words.append(f"view {view}: {gap_text(gap, holder.least_mm)}")
        red = gap.bodies
    elif not ghosts:  # clear, but too heavy
        loads = holder.loads(joints[None])[0]
        worst = int(loads.argmax())
        name = holder.cell.joint_names[worst]
        words.append(f"view {view}: {weak_text(name, float(loads[worst]))}")
    return HeldView(joints, Marks(red=red, ghosts=tuple(ghosts)), tuple(words))


def _nearest(
    holder: Holder, both: tuple[Floats, Floats], arm: int
) -> tuple[Floats, tuple[float, float]]:
    """Return an arm's configuration nearest to its pose, (1, k), and its error, mm and deg."""
    kinematics, cell = Kinematics(holder.cell, holder.motion.ik), holder.cell
    target = PosePairs.at(*(Pose.from_matrix(m[:3, 3], m[:3, :3]) for m in both))
    low, high = (
        np.maximum(cell.joint_ranges.T[0], -np.pi),
        np.minimum(cell.joint_ranges.T[1], np.pi),
    )
    rng, tries = np.random.default_rng(0), []
    for _ in range(STARTS):
        result = kinematics.solve(rng.uniform(low, high), target)
        off = float(result.position_mm[arm]), float(result.rotation_deg[arm])
        tries.append((off, result.joints[cell.arm_joints[arm]]))
    off, joints = min(tries, key=lambda one: one[0])
    return joints[None], off


def _widest(cell: CellModel, options: list[Floats]) -> tuple[Floats, Gap]:
    """Return the pair of configurations with the largest clearance, and its gap."""
    i, j = np.indices([len(of) for of in options]).reshape(2, -1)
    order = np.argsort(i + j, kind="stable")[:WIDEST_OF]
    pairs = np.hstack([options[0][i[order]], options[1][j[order]]])
    clearance = Clearance(cell)
    gaps = [clearance.over(q[None]) for q in pairs]
    best = int(np.argmax([gap.distance_mm for gap in gaps]))
    return pairs[best], gaps[best]


def reasons(
    search: CureSearch, lost: Sequence[int] | None, progress: Progress = SILENT
) -> tuple[list[int], list[str]]:
    """Find the views that cannot be held, and the smallest tested change that cures them.

    Args:
        search: search for a cure.
        lost: indices of the views that cannot be held; None to judge all views.
        progress: progress display.

    Returns:
        indices of the views that cannot be held, and messages.

    Raises:
        WorkSpentError: to judge the views needs more work than may be done.
    """
    if lost is None:
        holder = Holder(search.model, search.motion, roll_free=search.roll_free)
        lost = np.flatnonzero(~holder.held(search.poses(np.arange(search.views)))).tolist()
    if not lost:
        text = "each view alone can be held, but no path between them was found"
        if search.motion.scheme == "reactive":
            text += "; motion.scheme: planned searches for detours and changes of configuration"
        return [], [text]
    return [*lost], [search.words(np.array(lost), progress)]
