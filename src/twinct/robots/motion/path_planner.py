"""Detours of both arms between two configurations whose straight joint path is not clear.

OMPL's RRT-Connect (Kuffner and LaValle, "RRT-Connect: an efficient approach to single-query path
planning", ICRA 2000) and its shortcuts. Joints that can make full turns are angles on a circle;
the search decides in which turn they end. Searches check configurations at a certain spacing; the
straight segments of their results are then proven clear. Every search seeds OMPL, creates its
objects anew and stops at a count, so that equal queries give equal results whatever ran before.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np

from twinct.core.errors import MissingExtraError
from twinct.geometry import Floats
from twinct.robots.cell import CellModel
from twinct.robots.motion.collision_check import CollisionCheck
from twinct.robots.motion.feasible import Feasible, Flags
from twinct.robots.motion.strength import TORQUE_SHARE, Strength

SEARCHES = ((20_000, 0.1), (100_000, 0.03), (50_000, 0.3), (50_000, 0.3))
"""Number of configurations that a search may check, and their spacing on straight paths: the sum
of the times of all joints, s. In narrow places, trees whose branches are checked roughly grow
farther with as many checks; the last two searches draw other numbers. Every result is proven."""

STEP_S = 3.0
"""Longest step of a tree, as such a sum of times."""

SHORTCUTS = 100
"""Attempts to shorten a detour."""

FINE_S = 0.1
"""Spacing of the configurations that are checked on a shortcut, as such a sum of times."""

ASIDE_MM = (2.0, 8.0)
"""Margins of shortcuts above the required clearance, lest the proof fail between two checks."""


def _ompl() -> tuple[ModuleType, ModuleType, ModuleType]:
    try:
        from ompl import base, geometric, util
    except ImportError as error:
        raise MissingExtraError("ompl", "robots") from error
    return base, geometric, util


class Detours:
    """Search for detours in one cell.

    Attributes:
        most: number of checked configurations at which all searches end.
        holds: check that the joints can hold the arms along a detour; None for no such check.
    """

    def __init__(
        self, cell: CellModel, room: Feasible, turns: Flags, seed: int, most: float = np.inf
    ) -> None:
        """Silence OMPL and set up the collision checks.

        Args:
            cell: robot cell.
            room: clearance check for straight paths of both arms.
            turns: flags of the joints that can make full turns, (n,).
            seed: seed of every search.
            most: largest number of configurations that all searches together may check, without
                the shortcuts of the last search.

        Raises:
            MissingExtraError: OMPL is not installed.
        """
        _ompl()[2].setLogLevel(_ompl()[2].LOG_NONE)
        self._cell, self._room, self._turns, self._seed = cell, room, turns, seed
        self._collisions, self.most = CollisionCheck(cell), most
        self.holds: Strength | None = None

    @property
    def looked(self) -> int:
        """Number of configurations checked so far."""
        return self._collisions.looked

    @property
    def over(self) -> bool:
        """True once no search may check further configurations."""
        return self.looked >= self.most

    def between(
        self, start: Floats, end: Floats, least_mm: float, effort: int, *, turning: bool = True
    ) -> Floats | None:
        """Search for a detour whose straight segments are clear.

        Args:
            start: rad, (n,).
            end: rad, (n,).
            least_mm: required clearance.
            effort: index into SEARCHES.
            turning: True lets joints that can make full turns end in any turn and leave their
                ranges; False keeps all joints in their ranges and ends exactly at ``end``.

        Returns:
            knots, both ends included, rad, (knots, n); None if no detour was found.
        """
        checks, spacing_s = SEARCHES[effort]
        collisions, room = self._collisions, self._room

        strength = self.holds

        def proven(knots: Floats) -> bool:
            ends = knots[:-1], knots[1:]
            held = strength is None or bool(strength.straight(*ends).all())
            return held and bool(room.straight(*ends, least_mm).all())

        def clear(joints: Floats) -> bool:
            return collisions.clear(joints) and (
                strength is None or bool((strength.holding(joints[None]) < TORQUE_SHARE).all())
            )

        collisions.keep(least_mm)
        circles = self._turns & turning
        # Set the seed before creating any object with a random generator of its own.
        _ompl()[2].RNG.setSeed(self._seed + 1 + max(0, effort - 1))
        space = _Space(self._cell, circles)
        if self.over or not (clear(start) and clear(end)):
            return None
        most = min(collisions.looked + checks, self.most)
        path = space.connected(start, end, clear, spacing_s, lambda: collisions.looked >= most)
        if path is None:
            return None
        for aside_mm in ASIDE_MM:
            collisions.keep(least_mm + aside_mm)
            knots = space.shortened(path, clear)
            if proven(knots):
                break
        else:
            if not proven(knots := path):
                return None
        # Restore the exact ends, which OMPL may have rounded.
        knots[0] = start
        knots[-1] = end + circles * 2 * np.pi * np.rint((knots[-1] - end) / (2 * np.pi))
        return knots


@dataclass(frozen=True, eq=False)
class _Joints:
    """Conversion from OMPL's states: joints on a circle are angles, the others numbers."""

    circles: Flags

    def one(self, state: Any) -> Floats:
        """Return the joints of one state, rad, (n,); angles within half a turn."""
        circles = enumerate(self.circles.tolist())
        return np.array([state[j].value if circle else state[j][0] for j, circle in circles])

    def knots(self, states: Any) -> Floats:
        """Return the joints of states, rad, (m, n); angles go the shorter way between states."""
        joints = np.array([self.one(state) for state in states])
        joints[:, self.circles] = np.unwrap(joints[:, self.circles], axis=0)
        return joints


class _Space:
    """OMPL state space of both arms' joints; distances are the times that the joints take."""

    def __init__(self, cell: CellModel, circles: Flags) -> None:
        self._base, self._geometric, _ = _ompl()
        self._joints = _Joints(circles)
        self._space = self._base.CompoundStateSpace()
        speeds = cell.speed_limits * cell.speed_scales
        for circle, (low, high), speed in zip(circles, cell.joint_ranges, speeds, strict=True):
            if circle:
                joint = self._base.SO2StateSpace()
            else:
                joint, bounds = self._base.RealVectorStateSpace(1), self._base.RealVectorBounds(1)
                bounds.setLow(float(low))
                bounds.setHigh(float(high))
                joint.setBounds(bounds)
            self._space.addSubspace(joint, float(1 / speed))
        self._space.setup()

    def _state(self, joints: Floats) -> Any:
        state = self._space.allocState()
        for j, (circle, q) in enumerate(zip(self._joints.circles, joints.tolist(), strict=True)):
            if circle:
                state[j].value = (q + np.pi) % (2 * np.pi) - np.pi
            else:
                state[j][0] = q
        return state

    def connected(
        self,
        start: Floats,
        end: Floats,
        clear: Callable[[Floats], bool],
        spacing_s: float,
        over: Callable[[], bool],
    ) -> Floats | None:
        """Return the knots of a path by RRT-Connect, (m, n); None if the search ended before."""
        information = self._judged(clear, spacing_s)
        problem = self._base.ProblemDefinition(information)
        problem.setStartAndGoalStates(self._state(start), self._state(end))
        planner = self._geometric.RRTConnect(information)
        planner.setRange(STEP_S)
        planner.setProblemDefinition(problem)
        planner.setup()
        planner.solve(self._base.PlannerTerminationCondition(over))
        if not problem.hasExactSolution():
            return None
        return self._from(start, problem.getSolutionPath())

    def shortened(self, knots: Floats, clear: Callable[[Floats], bool]) -> Floats:
        """Shorten a path and reduce its knots; the ends stay, except for full turns."""
        information = self._judged(clear, FINE_S)
        path = self._geometric.PathGeometric(information)
        for q in knots:
            path.append(self._state(q))
        simplifier = self._geometric.PathSimplifier(information)
        simplifier.reduceVertices(path, SHORTCUTS, SHORTCUTS // 2)
        simplifier.partialShortcutPath(path, SHORTCUTS, SHORTCUTS // 2)
        simplifier.reduceVertices(path, SHORTCUTS, SHORTCUTS // 2)
        return self._from(knots[0], path)

    def _judged(self, clear: Callable[[Floats], bool], spacing_s: float) -> Any:
        joints, information = self._joints, self._base.SpaceInformation(self._space)
        information.setStateValidityChecker(lambda state: clear(joints.one(state)))
        information.setStateValidityCheckingResolution(spacing_s / self._space.getMaximumExtent())
        information.setup()
        return information

    def _from(self, start: Floats, path: Any) -> Floats:
        """Return the knots of a path; joints on a circle begin in the turn of the start."""
        knots = self._joints.knots(path.getStates())
        return knots + 2 * np.pi * np.rint((start - knots[0]) / (2 * np.pi))
