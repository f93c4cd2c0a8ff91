"""Plans from the current joints to targets outside the plan, and home."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from twinct.core.errors import NoPathError, TargetRefusedError, TrajectoryError
from twinct.geometry import Floats
from twinct.geometry.wire import PosePairs
from twinct.robots.cell import CellModel
from twinct.robots.motion.feasible import Feasible
from twinct.robots.motion.path_search import JointPath, find_joint_path, required_gap_mm
from twinct.robots.motion.plan import MotionPlan, timed
from twinct.robots.motion.refusals import arms_in
from twinct.robots.motion.return_path import path_home
from twinct.robots.sections import Motion

MOST_LOOKS = 60_000
"""Configurations that one search may check, from the current joints, and again from home.

Each search takes about 5 s: an answer is promised within 10 s.
"""


class Guide:
    """Path search that stores the paths taken since home, because they lead back."""

    def __init__(
        self, cell: CellModel, motion: Motion, roll_free: tuple[bool, bool], home: Floats
    ) -> None:
        """Start with the arms at home.

        Args:
            cell: robot cell.
            motion: clearance, limits.
            roll_free: whether source and panel may roll about their own axes.
            home: rad, (n,).
        """
        self._cell, self._motion, self._roll_free, self._home = cell, motion, roll_free, home
        # Knots of the paths since home; empty after a move on an unknown path.
        self._trail: list[Floats] = [home[None]]

    def forget(self) -> None:
        """Discard the stored paths after a move on an unknown path."""
        self._trail = []

    def to(self, target: PosePairs, here: Floats) -> MotionPlan:
        """Plan a path to a target from joints ``here``, rad, (n,), and store it as taken.

        Raises:
            TargetRefusedError: no path was found.
        """
        return self._planned(partial(self._way_to, target), here)

    def home(self, here: Floats) -> MotionPlan:
        """Plan a path home from joints ``here``, rad, (n,), and store it as taken.

        Raises:
            TargetRefusedError: no path was found.
        """
        return self._planned(self._way_home, here)

    def _planned(self, find: Callable[[Floats], JointPath], here: Floats) -> MotionPlan:
        try:
            way = find(here)
            plan = timed(self._cell, self._motion, way)
        except TrajectoryError as error:
            # The caller knows a target, no view 0.
            problems = [problem.removeprefix("view 0: ") for problem in error.problems]
            text = "; ".join(problems).replace("view 0", "the target")
            raise TargetRefusedError(text, arms_in(text)) from None
        if len(at_home := np.flatnonzero((way.joints == self._home).all(axis=1))):
            self._trail = [way.joints[at_home[-1] :]]
        elif self._trail:
            ends = self._home[None], way.joints[-1:]
            direct = Feasible(self._cell).straight(*ends, required_gap_mm(self._motion))[0]
            self._trail = list(ends) if direct else [*self._come(here), way.joints[1:]]
        return plan

    def _way_to(self, target: PosePairs, here: Floats) -> JointPath:
        """Find a path to a target; if none is found and the path back is known, go through home."""
        search = partial(
            find_joint_path,
            self._cell,
            self._motion,
            [target],
            roll_free=self._roll_free,
            most_looks=MOST_LOOKS,
        )
        try:
            return search(start=here)
        except NoPathError:
            if not self._trail or np.array_equal(here, self._home):
                raise
            back, on = self._way_home(here), search(start=self._home)
            views = np.append(np.full(len(back.joints) - 1, -1), on.views)
            return JointPath(np.vstack([back.joints[:-1], on.joints]), views, on.targets)

    def _way_home(self, here: Floats) -> JointPath:
        back = np.vstack(self._come(here))[::-1] if self._trail else np.zeros((0, len(here)))
        return path_home(self._cell, self._motion, here, self._home, back, most_looks=MOST_LOOKS)

    def _come(self, here: Floats) -> list[Floats]:
        """Return the path since home up to joints ``here``, where the arms came to rest."""
        return self._trail if (self._trail[-1][-1] == here).all() else [*self._trail, here[None]]
