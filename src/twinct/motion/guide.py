"""Plans to targets of no plan, and home, from wherever the arms are."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from twinct.cell import CellModel
from twinct.errors import NoWayError, TargetRefusedError, TrajectoryError
from twinct.geometry import Floats
from twinct.motion.feasible import Feasible
from twinct.motion.homeward import way_home
from twinct.motion.plan import MotionPlan, timed
from twinct.motion.refusals import arms_in
from twinct.motion.way import Way, find_way, kept_mm
from twinct.scenario import Motion
from twinct.views import Target

MOST_LOOKS = 60_000
"""Configurations that the search for a way to a target may look at, and again from home.

Both take about 5 s: an answer is promised within 10.
"""


class Guide:
    """Finds ways, and remembers those that the arms went since home: they lead back."""

    def __init__(
        self, cell: CellModel, motion: Motion, roll_free: tuple[bool, bool], home: Floats
    ) -> None:
        """Take the arms to be at home.

        Args:
            cell: the room.
            motion: clearance, limits.
            roll_free: whether source and panel may be turned about their own axis.
            home: rad, (n,).
        """
        self._cell, self._motion, self._roll_free, self._home = cell, motion, roll_free, home
        # Knots of the ways since home; none: the arms went by other ways than these.
        self._trail: list[Floats] = [home[None]]

    def forget(self) -> None:
        """The arms went by a way that is not known here."""
        self._trail = []

    def to(self, target: Target, here: Floats) -> MotionPlan:
        """The arms are going to follow it: a plan to a target from where they are, rad, (n,).

        Raises:
            TargetRefusedError: there is none.
        """
        return self._planned(partial(self._way_to, target), here)

    def home(self, here: Floats) -> MotionPlan:
        """The arms are going to follow it: a plan home from where they are, rad, (n,).

        Raises:
            TargetRefusedError: there is none.
        """
        return self._planned(self._way_home, here)

    def _planned(self, find: Callable[[Floats], Way], here: Floats) -> MotionPlan:
        try:
            way = find(here)
            plan = timed(self._cell, self._motion, way)
        except TrajectoryError as error:
            # Who asks knows no view 0.
            told = [problem.removeprefix("view 0: ") for problem in error.problems]
            text = "; ".join(told).replace("view 0", "the target")
            raise TargetRefusedError(text, arms_in(text)) from None
        if len(at_home := np.flatnonzero((way.joints == self._home).all(axis=1))):
            self._trail = [way.joints[at_home[-1] :]]
        elif self._trail:
            ends = self._home[None], way.joints[-1:]
            direct = Feasible(self._cell).straight(*ends, kept_mm(self._motion))[0]
            self._trail = list(ends) if direct else [*self._trail, way.joints[1:]]
        return plan

    def _way_to(self, target: Target, here: Floats) -> Way:
        """From where the arms are; where none is found and the way back is known, over home."""
        found = partial(
            find_way,
            self._cell,
            self._motion,
            [target],
            roll_free=self._roll_free,
            most_looks=MOST_LOOKS,
        )
        try:
            return found(start=here)
        except NoWayError:
            if not self._trail or np.array_equal(here, self._home):
                raise
            back, on = self._way_home(here), found(start=self._home)
            views = np.append(np.full(len(back.joints) - 1, -1), on.views)
            return Way(np.vstack([back.joints[:-1], on.joints]), views, on.targets)

    def _way_home(self, here: Floats) -> Way:
        back = np.vstack(self._trail)[::-1] if self._trail else np.zeros((0, len(here)))
        return way_home(self._cell, self._motion, here, self._home, back, most_looks=MOST_LOOKS)
