"""Search for the smallest change of a scenario that cures infeasible views.

The closed form bounds how many views each change can cure, without building the changed cell. The
changes with the largest bounds are then tried, the smallest of them first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from twinct.core.errors import ScenarioError
from twinct.core.progress import SILENT, Progress, WorkSpentError
from twinct.geometry import Floats
from twinct.robots.cell import CellModel, apart
from twinct.robots.motion.branches import SIDES, Branches
from twinct.robots.motion.feasible import Indices
from twinct.robots.reach.holding import Flags, Holder, TargetPoses
from twinct.robots.reach.remedy import Remedy
from twinct.robots.sections import Cell, Motion

FAILING = 8
"""Number of infeasible views, evenly spaced, for which a cure is sought."""

OTHERS = 24
"""Number of feasible views, evenly spaced, that a cure must keep feasible."""

SHIFTS_MM = (50.0, 100.0, 200.0)
STANDOFFS_MM = (-25.0, 25.0, -50.0, 50.0, -100.0, 100.0)
RADII = (0.95, 1.05, 0.9, 1.1, 0.8, 1.2)
"""Changes that are tried, the smallest first."""

MORE = "twinct check --all-cures tries the others"
TESTED = (
    "tested: turns about the beam, base shifts to 200 mm, stand-offs to 100 mm, radii to 20 %; "
    "see twinct place"
)
"""Ends of the sentence, where some or all changes were tried."""


@dataclass(frozen=True, eq=False)
class Change:
    """One change of a scenario.

    Attributes:
        words: keys with their new values, for people.
        keys: plain values by dotted key; those of a scaled trajectory are not among them.
        cell: section of the changed cell.
        roll_free: whether source and panel may then roll about their own axes.
        arm: index of the only arm that changes, if one.
        shift_mm: shift of this arm's base, (3,).
        forward_mm: shift of this arm's tool along its own axis.
        scale: factor of the distances of source and panel from the middle of the beam.
    """

    words: str
    keys: Mapping[str, Any]
    cell: Cell
    roll_free: tuple[bool, bool]
    arm: int | None = None
    shift_mm: Floats = field(default_factory=lambda: np.zeros(3))
    forward_mm: float = 0.0
    scale: float = 1.0

    def scaled(self, poses: TargetPoses) -> TargetPoses:
        """Return the poses of the changed trajectory."""
        middle = (poses.source[:, :3, 3] + poses.detector[:, :3, 3]) / 2
        moved = TargetPoses(poses.source.copy(), poses.detector.copy())
        for matrices in (moved.source, moved.detector):
            matrices[:, :3, 3] = middle + self.scale * (matrices[:, :3, 3] - middle)
        return moved

    def seen_by(self, poses: TargetPoses, arm: int) -> Floats:
        """Return poses that are to an unchanged arm what ``poses`` are to the changed one."""
        moved = self.scaled(poses)
        seen = (moved.source, moved.detector)[arm].copy()
        if arm == self.arm:
            seen[:, :3, 3] -= self.shift_mm + self.forward_mm * seen[:, :3, 2]
        return seen


class _Hopes:
    """Largest numbers of views that changes may cure, as far as each arm's reach shows."""

    def __init__(
        self, model: CellModel, motion: Motion, roll_free: tuple[bool, bool], commanded: TargetPoses
    ) -> None:
        self._roll_free, self._commanded = roll_free, commanded
        self._branches = [Branches(model, arm, motion.ik) for arm in range(2)]
        self.alone = [_alone(model, motion, roll_free, commanded, arm) for arm in range(2)]

    def of(self, change: Change) -> int:
        held = np.ones(len(self._commanded), bool)
        for arm, branches in enumerate(self._branches):
            turned = change.roll_free[arm] != self._roll_free[arm]
            if change.scale == 1 and change.arm != arm and not turned:
                held &= self.alone[arm]
            elif branches.closed_form:  # its last joint only rolls the tool
                seen = change.seen_by(self._commanded, arm)
                held &= np.isin(np.arange(len(held)), branches.of(seen).pose)
        return int(held.sum())


def _alone(
    cell: CellModel, motion: Motion, roll_free: tuple[bool, bool], commanded: TargetPoses, arm: int
) -> Flags:
    """Return flags of the views that an arm can hold, wherever the other one stands."""
    bodies, other = cell.model.geom_bodyid, SIDES[1 - arm]
    of_other = np.array([cell.model.body(body).name.startswith(f"{other}_") for body in bodies])
    own = replace(cell, pairs=cell.pairs[~of_other[cell.pairs].any(axis=1)])
    return Holder(own, motion, roll_free=roll_free).can(
        (commanded.source, commanded.detector)[arm], arm
    )


@dataclass(frozen=True, eq=False)
class CureSearch:
    """Search for a cure, which ends at the latest with the work that it may do.

    Attributes:
        cell: section of the cell.
        model: the cell.
        builders: builders of changed cells, the last one exact; most changes fail the first one.
        motion: tolerances, and the required clearance.
        roll_free: whether source and panel may roll about their own axes.
        views: number of views.
        poses: returns the poses of some views.
    """

    cell: Cell
    model: CellModel
    builders: Sequence[Callable[[Cell], CellModel]]
    motion: Motion
    roll_free: tuple[bool, bool]
    views: int
    poses: Callable[[Indices], TargetPoses]

    def words(self, failing: Indices, progress: Progress = SILENT) -> str:
        """Return a sentence about the best change that was found; a ``Remedy`` if there is one.

        A cure is tested on at most FAILING infeasible views, and must keep at most OTHERS feasible
        views. Paths between views are not checked.

        Args:
            failing: indices of the views that cannot be held.
            progress: progress display.
        """
        commanded = self.poses(_some(failing, FAILING))
        scope = f"{len(commanded)} tested views (of {len(failing)} that cannot be held)"
        changes = list(_changes(self.cell, self.roll_free))
        best, gained, tried = None, 0, 0
        try:
            hopes = _Hopes(self.model, self.motion, self.roll_free, commanded)
            ranked = [(hopes.of(change), change) for change in changes]
            ranked.sort(key=lambda one: -one[0])
            with progress.stage("changes that may be a remedy", len(changes)) as step:
                for hope, change in ranked:
                    if hope > gained:
                        gain = self._gained(change, commanded, failing, gained, hopes)
                        best, gained = (change, gain) if gain else (best, gained)
                    tried += 1
                    step()
        except WorkSpentError:
            pass
        all_tried = tried == len(changes)
        left = f"{tried} of {len(changes)} changes were tried, in the time of planning; {MORE}"
        if best is not None:
            text = f"partial cure: {best.words}; this cures {gained} of the {scope}"
            if gained == len(commanded):
                text = f"cure: {best.words}; this cures the {scope}"
            elif not all_tried:
                text += f"; {left}"
            return Remedy(text, best.keys, best.scale)
        return f"no single change cures the {scope}; {TESTED if all_tried else left}"

    def _gained(
        self, change: Change, commanded: TargetPoses, failing: Indices, least: int, hopes: _Hopes
    ) -> int:
        """Return the number of views that a change cures, 0 unless above ``least`` and no loss."""
        gained, holder = 0, None
        # A change of roll or radius needs no other cell.
        builders = self.builders if change.arm is not None else [lambda _: self.model]
        for build in builders:
            try:
                model = apart(build(change.cell))
            except ScenarioError:  # no room for the panel, or a base in the table
                return 0
            holder = Holder(model, self.motion, roll_free=change.roll_free)
            if (arm := change.arm) is not None:  # the changed arm alone may show that it is no use
                own = holder.can((commanded.source, commanded.detector)[arm], arm)
                if (own & hopes.alone[1 - arm]).sum() <= least:
                    return 0
            gained = int(holder.held(change.scaled(commanded)).sum())
            if gained <= least:
                return 0
        assert holder is not None
        return gained if holder.held(change.scaled(self._kept(failing))).all() else 0

    def _kept(self, failing: Indices) -> TargetPoses:
        """Return some feasible views."""
        others = np.setdiff1d(np.arange(self.views), failing)
        if not len(others):
            return self.poses(others)
        some = self.poses(_some(others, OTHERS))
        held = Holder(self.model, self.motion, roll_free=self.roll_free).held(some)
        return some[np.flatnonzero(held)]


def _some(views: Indices, count: int) -> Indices:
    return views[np.unique(np.linspace(0, len(views) - 1, min(count, len(views))).astype(int))]


def _changes(cell: Cell, roll_free: tuple[bool, bool]) -> Iterator[Change]:
    """Yield the changes to try."""
    for free in ((roll_free[0], True), (True, True)):
        if free != roll_free:
            opened = zip(SIDES, free, roll_free, strict=True)
            sides = [side for side, now, before in opened if now > before]
            words = " and ".join(f"motion.{side}_roll: free" for side in sides)
            keys = {f"motion.{side}_roll": "free" for side in sides}
            yield Change(words, keys, cell, free)
    moves = [
        (size, arm, "base_position_mm", axis, sign * size)
        for arm in range(2)
        for axis in range(3)
        for size in SHIFTS_MM
        for sign in (1, -1)
    ] + [(abs(by), arm, "standoff_mm", 0, by) for arm in range(2) for by in STANDOFFS_MM]
    for _, arm, key, axis, by in sorted(moves, key=lambda move: move[0]):
        side = SIDES[arm]
        section = getattr(cell, f"{side}_arm")
        shift_mm = by * np.eye(3)[axis] if key == "base_position_mm" else np.zeros(3)
        forward_mm = by if key == "standoff_mm" else 0.0
        if section.standoff_mm + forward_mm <= 0:
            continue
        place = (np.array(section.base_position_mm, dtype=np.float64) + shift_mm).tolist()
        value = section.standoff_mm + forward_mm if forward_mm else place
        moved = section.model_copy(update={key: value if forward_mm else tuple(place)})
        changed = cell.model_copy(update={f"{side}_arm": moved})
        name = f"cell.{side}_arm.{key}"
        yield Change(
            f"{name}: {value}", {name: value}, changed, roll_free, arm, shift_mm, forward_mm
        )
    for scale in RADII:
        words = f"trajectory.sod_mm and sdd_mm times {scale:g}"
        yield Change(words, {}, cell, roll_free, scale=scale)
