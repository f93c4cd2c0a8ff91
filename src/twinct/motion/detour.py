"""Ways round: both arms together, from one configuration to another, where straight is not clear.

OMPL's RRT-Connect (Kuffner and LaValle, "RRT-Connect: an efficient approach to single-query path
planning", ICRA 2000) and its shortcuts. All of OMPL is made anew after its seed and stopped by a
count, so that the same question has the same answer whatever ran before.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from types import ModuleType
from typing import Any

import numpy as np

from twinct.errors import MissingExtraError
from twinct.geometry import Floats
from twinct.motion.feasible import Feasible, Flags, Indices

SEARCHES = (
    (0.5, 100, True),
    (1.5, 700, True),
    (1.0, 150, False),
    (np.pi, 500, False),
    (np.pi, 1500, True),
)
"""How far beyond both ends each joint may go, rad; how many straight paths may be looked at in a
search; whether both arms move together, or one after the other."""

STEP_S = 0.4
"""Longest step of a tree, as the time that the slowest joint takes."""

SHORTCUTS = 40
"""Tries to shorten a way that was found."""


def _ompl() -> tuple[ModuleType, ModuleType, ModuleType]:
    try:
        from ompl import base, geometric, util
    except ImportError as error:
        raise MissingExtraError("ompl", "robots") from error
    return base, geometric, util


class Detours:
    """Searches ways round in one cell."""

    def __init__(
        self,
        room: Feasible,
        ranges: Floats,
        speeds: Floats,
        arms: tuple[slice, slice],
        seed: int,
    ) -> None:
        """Prepare.

        Args:
            room: judges straight paths of both arms.
            ranges: of the joints, rad, (n, 2).
            speeds: rad/s, (n,): what counts as far.
            arms: the joints of each.
            seed: of every search.

        Raises:
            MissingExtraError: OMPL is not installed.
        """
        self._ompl = _ompl()
        self._room, self._ranges, self._speeds = room, ranges, speeds
        self._arms, self._seed = arms, seed

    def between(self, start: Floats, end: Floats, least_mm: float, effort: int) -> Floats | None:
        """A way that is clear on the straight paths between its knots.

        Args:
            start: rad, (n,).
            end: rad, (n,).
            least_mm: the clearance asked for.
            effort: which of SEARCHES.

        Returns:
            knots, both ends included, rad, (knots, n); None: none was found.
        """
        beyond, checks, together = SEARCHES[effort]
        low = np.maximum(self._ranges[:, 0], np.minimum(start, end) - beyond)
        high = np.minimum(self._ranges[:, 1], np.maximum(start, end) + beyond)
        # Before any object with a generator of its own is made.
        self._ompl[2].RNG.setSeed(self._seed + 1)
        whole = _Space(self._ompl, self._room, self._speeds, start, (low, high), least_mm)
        if together:
            found = whole.connected(start, end, checks)
            return None if found is None else whole.shortened(found)
        for order in (self._arms, self._arms[::-1]):
            middle = start.copy()
            middle[order[0]] = end[order[0]]
            found = []
            for a, b, arm in ((start, middle, order[0]), (middle, end, order[1])):
                box = (np.where(_in(arm, a), low, a), np.where(_in(arm, a), high, a))
                leg = _Space(self._ompl, self._room, self._speeds, a, box, least_mm)
                found.append(leg.connected(a, b, checks))
                if found[-1] is None:
                    break
            else:
                return whole.shortened(np.vstack([found[0], found[1][1:]]))
        return None


def _in(part: slice, joints: Floats) -> Flags:
    """Which joints are of an arm."""
    inside = np.zeros(len(joints), bool)
    inside[part] = True
    return inside


@dataclass(frozen=True, eq=False)
class _Told:
    """How OMPL's states tell joints: the moving ones, each divided by its speed."""

    still: Floats
    moving: Indices
    speeds: Floats

    def joints(self, state: Any) -> Floats:
        joints = self.still.copy()
        moved = [state[k] for k in range(len(self.moving))]
        joints[self.moving] = moved * self.speeds[self.moving]
        return joints


@cache
def _validator() -> type:
    """OMPL's judge of straight paths. It must not know who holds it: OMPL's memory is counted."""

    class Straight(_ompl()[0].MotionValidator):
        def __init__(self, information: Any, told: _Told, room: Feasible, least_mm: float) -> None:
            super().__init__(information)
            self.looked = 0
            self._told, self._room, self._least_mm = told, room, least_mm

        def checkMotion(self, first: Any, second: Any) -> bool:  # noqa: N802
            self.looked += 1
            a, b = self._told.joints(first), self._told.joints(second)
            return bool(self._room.straight(a[None], b[None], self._least_mm)[0])

    return Straight


class _Space:
    """OMPL's view of the joints that may move, told as the time that each takes."""

    def __init__(
        self,
        ompl: tuple[ModuleType, ModuleType, ModuleType],
        room: Feasible,
        speeds: Floats,
        still: Floats,
        box: tuple[Floats, Floats],
        least_mm: float,
    ) -> None:
        base, self._geometric, util = ompl
        util.setLogLevel(util.LOG_NONE)
        self._base = base
        self._moving = np.flatnonzero(box[0] < box[1])
        self._told = _Told(still, self._moving, speeds)
        self._space = base.RealVectorStateSpace(len(self._moving))
        bounds = base.RealVectorBounds(len(self._moving))
        for k, j in enumerate(self._moving):
            # Slack for what division and multiplication round.
            bounds.setLow(k, box[0][j] / speeds[j] - 1e-9)
            bounds.setHigh(k, box[1][j] / speeds[j] + 1e-9)
        self._space.setBounds(bounds)
        self._information = base.SpaceInformation(self._space)
        # A straight path is judged with its ends.
        self._information.setStateValidityChecker(lambda state: True)
        self._straight = _validator()(self._information, self._told, room, least_mm)
        self._information.setMotionValidator(self._straight)
        self._information.setup()

    def _state(self, joints: Floats) -> Any:
        state = self._space.allocState()
        for k, j in enumerate(self._moving):
            state[k] = float(joints[j] / self._told.speeds[j])
        return state

    def connected(self, start: Floats, end: Floats, checks: int) -> Floats | None:
        """Knots (m, n) by RRT-Connect; None where it looked at so many straight paths in vain."""
        problem = self._base.ProblemDefinition(self._information)
        problem.setStartAndGoalStates(self._state(start), self._state(end))
        planner = self._geometric.RRTConnect(self._information)
        planner.setRange(STEP_S)
        planner.setProblemDefinition(problem)
        planner.setup()
        straight = self._straight
        most = straight.looked + checks
        planner.solve(self._base.PlannerTerminationCondition(lambda: straight.looked >= most))
        if not problem.hasExactSolution():
            return None
        return self._knots(problem.getSolutionPath(), start, end)

    def shortened(self, knots: Floats) -> Floats:
        """The same ends, with fewer knots on a shorter way."""
        path = self._geometric.PathGeometric(self._information)
        for q in knots:
            path.append(self._state(q))
        simplifier = self._geometric.PathSimplifier(self._information)
        simplifier.reduceVertices(path, SHORTCUTS, SHORTCUTS // 2)
        simplifier.partialShortcutPath(path, SHORTCUTS, SHORTCUTS // 2)
        simplifier.reduceVertices(path, SHORTCUTS, SHORTCUTS // 2)
        return self._knots(path, knots[0], knots[-1])

    def _knots(self, path: Any, start: Floats, end: Floats) -> Floats:
        """The ends to the last bit: what is in between may be rounded."""
        knots = np.array([self._told.joints(state) for state in path.getStates()])
        knots[0], knots[-1] = start, end
        return knots
