"""Diagnosis of infeasible views: the reason, a change that cures it, and the closest attempt."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from twinct.core.errors import ScenarioError
from twinct.core.progress import SILENT, Progress
from twinct.geometry import Floats, Pose
from twinct.geometry.wire import PosePairs
from twinct.robots.cell import CellModel, Clearance, Gap, Marks, apart
from twinct.robots.motion import Kinematics
from twinct.robots.motion.branches import SIDES
from twinct.robots.motion.feasible import Indices
from twinct.robots.motion.refusals import far_problems, gap_text
from twinct.robots.reach.holding import Holder, Poses
from twinct.scenario import Cell, Motion

FAILING = 8
"""Number of infeasible views, evenly spaced, for which a cure is sought."""

OTHERS = 24
"""Number of feasible views, evenly spaced, that a cure must keep feasible."""

STARTS = 8
"""Random starts of the search for an arm's configuration nearest to a pose."""

WIDEST_OF = 64
"""Largest number of pairs of configurations among which the largest clearance is sought."""

SHIFTS_MM = (50.0, 100.0, 200.0)
STANDOFFS_MM = (-25.0, 25.0, -50.0, 50.0, -100.0, 100.0)
RADII = (0.95, 1.05, 0.9, 1.1, 0.8, 1.2)
"""Changes that are tried as a cure, the smallest first."""


@dataclass(frozen=True, eq=False)
class View:
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


def shown(holder: Holder, poses: Poses, view: int) -> View:
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
        return View(pairs[0], Marks(), ())
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
    return View(joints, Marks(red=red, ghosts=tuple(ghosts)), tuple(words))


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
    cell: Cell,
    build: Callable[[Cell], CellModel],
    motion: Motion,
    poses: Poses,
    roll_free: tuple[bool, bool],
    rough: Callable[[Cell], CellModel] | None = None,
    progress: Progress = SILENT,
) -> tuple[list[int], list[str]]:
    """Find the views that cannot be held, and the smallest tested change that cures them.

    A cure is tested on at most FAILING infeasible views, and must keep at most OTHERS feasible
    views. Paths between views are not checked.

    Args:
        cell: section of the cell.
        build: builds the model of a cell section.
        motion: tolerances, and the required clearance.
        poses: poses of all views.
        roll_free: whether source and panel may roll about the beam.
        rough: builds a model faster that holds every view that the model of ``build`` holds.
        progress: progress display.

    Returns:
        indices of the views that cannot be held, and messages.
    """
    held = Holder(build(cell), motion, roll_free=roll_free).held(poses)
    failing, fine = np.flatnonzero(~held), np.flatnonzero(held)
    if not len(failing):
        text = "each view alone can be held, but no path between them was found"
        if motion.scheme == "reactive":
            text += "; motion.scheme: planned searches for detours and changes of configuration"
        return [], [text]
    asked, kept = _some(failing, FAILING), _some(fine, OTHERS)
    scope = f"{len(asked)} tested views (of {len(failing)} that cannot be held)"
    tests = [(make, poses[asked], poses[kept]) for make in ((rough, build) if rough else (build,))]
    first, own, _ = tests[0]
    without = [_not_held(first(cell), motion, roll_free, own, arm) for arm in range(2)]
    gained, words = _best_change(cell, motion, roll_free, tests, without, progress)
    if gained == len(asked):
        return failing.tolist(), [f"cure: {words}; this cures the {scope}"]
    if gained:
        text = f"partial cure: {words}; this cures {gained} of the {scope}"
        return failing.tolist(), [text]
    tried = "turns about the beam, base shifts to 200 mm, stand-offs to 100 mm, radii to 20 %"
    return failing.tolist(), [
        f"no single change cures the {scope}; tested: {tried}; see twinct place"
    ]


def _not_held(
    cell: CellModel, motion: Motion, roll_free: tuple[bool, bool], asked: Poses, arm: int
) -> int:
    """Return the number of views that an arm cannot hold, wherever the other one stands."""
    bodies, other = cell.model.geom_bodyid, SIDES[1 - arm]
    of_other = np.array([cell.model.body(body).name.startswith(f"{other}_") for body in bodies])
    own = replace(cell, pairs=cell.pairs[~of_other[cell.pairs].any(axis=1)])
    held = Holder(own, motion, roll_free=roll_free).can((asked.source, asked.detector)[arm], arm)
    return int((~held).sum())


def _best_change(
    cell: Cell,
    motion: Motion,
    roll_free: tuple[bool, bool],
    tests: list[tuple[Callable[[Cell], CellModel], Poses, Poses]],
    lost: list[int],
    progress: Progress,
) -> tuple[int, str]:
    """Return the number of views that the best change cures, and its words.

    Each test has a builder of the cell, views to cure, and views to keep; most changes fail the
    first one. Of the views to cure, each arm cannot hold some (``lost``) whatever is changed about
    the other one.
    """
    best, best_words = 0, ""
    changes = list(_changes(cell, roll_free))
    with progress.stage("changes that may be a remedy", len(changes)) as step:
        for words, changed, turned, scale, arm in changes:
            step()
            gained = 0
            if arm is not None and len(tests[0][1]) - lost[1 - arm] <= best:
                continue  # the other arm cannot hold more views
            for build, asked, kept in tests:
                try:
                    holder = Holder(apart(build(changed)), motion, roll_free=turned)
                except ScenarioError:  # no room for the panel, or a base in the table
                    gained = 0
                    break
                gained = int(holder.held(_scaled(asked, scale)).sum())
                if gained <= best or not holder.held(_scaled(kept, scale)).all():
                    gained = 0
                    break
            if gained > best:
                best, best_words = gained, words
            if best == len(tests[0][1]):
                break
    return best, best_words


def _some(views: Indices, count: int) -> Indices:
    return views[np.unique(np.linspace(0, len(views) - 1, min(count, len(views))).astype(int))]


def _scaled(poses: Poses, scale: float) -> Poses:
    """Scale the distances of source and panel from the middle of the beam."""
    middle = (poses.source[:, :3, 3] + poses.detector[:, :3, 3]) / 2
    moved = Poses(poses.source.copy(), poses.detector.copy())
    for matrices in (moved.source, moved.detector):
        matrices[:, :3, 3] = middle + scale * (matrices[:, :3, 3] - middle)
    return moved


def _changes(
    cell: Cell, roll_free: tuple[bool, bool]
) -> Iterator[tuple[str, Cell, tuple[bool, bool], float, int | None]]:
    """Yield the changes to try: in words, cell, free rolls, scale of the radius, and arm if one."""
    for free in ((roll_free[0], True), (True, True)):
        if free != roll_free:
            opened = zip(SIDES, free, roll_free, strict=True)
            keys = [f"motion.{side}_roll: free" for side, now, before in opened if now > before]
            yield " and ".join(keys), cell, free, 1.0, None
    arms = [(side, getattr(cell, f"{side}_arm")) for side in SIDES]
    shifts = [
        (abs(shift), side, arm, "base_position_mm", axis, shift)
        for side, arm in arms
        for axis in range(3)
        for size in SHIFTS_MM
        for shift in (size, -size)
    ] + [
        (abs(shift), side, arm, "standoff_mm", 0, shift)
        for side, arm in arms
        for shift in STANDOFFS_MM
    ]
    for _, side, arm, key, axis, shift in sorted(shifts, key=lambda change: change[0]):
        value = np.atleast_1d(np.array(getattr(arm, key), dtype=np.float64))
        value[axis] += shift
        if key == "standoff_mm" and value[0] <= 0:
            continue
        told = value.tolist() if len(value) > 1 else float(value[0])
        update = {key: tuple(told) if isinstance(told, list) else told}
        changed = cell.model_copy(update={f"{side}_arm": arm.model_copy(update=update)})
        yield f"cell.{side}_arm.{key}: {told}", changed, roll_free, 1.0, SIDES.index(side)
    for scale in RADII:
        words = f"trajectory.sod_mm and sdd_mm times {scale:g}"
        yield words, cell, roll_free, scale, None
