"""Goals that replace each other while the arms move, are late, start later, or are cancelled.

The judge shares no code with twinct's gate: it differentiates the reference that the arms were
given, and the joints as they moved, and knows how far a joint needs to brake.
"""

from __future__ import annotations

import random

import numpy as np
from goals import SETTLED_S, Goal, Goals

from twinct.robots.cell import CellModel
from twinct.robots.motion import GoalError, PursuingSimulation, goal_of

OVER = 1.02
"""Share of a limit that the page allows: joints follow polynomials between points."""

TREMBLE_RAD = np.radians(0.2)
"""Way of a joint beside its reference between two samples: errors of the servos in motion."""

STILL_RAD = np.radians(0.01)
"""Largest distance of a joint at rest from where it was sent last."""

LATEST_S = 1.0
"""Longest time between a goal and its start, before or after."""

CANCELLED = 0.2
"""Share of the goals that are cancelled."""

UNNAMED = "moves, but is not named"


class Overlaps:
    """Goals on top of each other, and what was seen.

    Attributes:
        taken, refused: number of goals.
        trembled_deg: largest distance of an unnamed joint from its reference, in motion.
        wrong: sentences on joints that moved unnamed, and on steps above the limits.
    """

    def __init__(self, simulation: PursuingSimulation, goals: Goals, cell: CellModel) -> None:
        """Start with the arms at rest."""
        self._simulation, self._goals, self._cell = simulation, goals, cell
        self._timestep = cell.model.opt.timestep
        self._acceleration = goals.acceleration
        self.taken, self.refused = 0, 0
        self.wrong: list[str] = []
        self.trembled_deg = 0.0

    def play(self, rng: random.Random, count: int) -> None:
        """Send goals, each at a random time of the one before; cancel some; then let all rest."""
        ahead: np.ndarray | None = None
        state = self._standing()
        for _ in range(count):
            goal = self._goals.draw(rng, state[0])
            tried = self._tried(rng, goal, ahead)
            if tried is None:
                self.refused += 1
                states = ahead if ahead is not None else np.repeat(state[None], 10, axis=0)
            else:
                self.taken += 1
                states, waits = tried
                splice = np.concatenate([state[None], states])[waits:]
                self._judge_unnamed(goal, splice[0], splice[:, 0])
            ahead, state = self._follow(states, rng.randint(1, len(states)), state)
            if rng.random() < CANCELLED:
                self._simulation.brake()
                self._rest()
                ahead, state = None, self._standing()
        if ahead is not None:
            self._follow(ahead, len(ahead), state)
        self._rest()

    def _rest(self) -> None:
        self._simulation.idle(SETTLED_S)
        off = np.abs(self._simulation.joints - self._standing()[0])
        self._complain(off > STILL_RAD, "rests elsewhere")

    def _standing(self) -> np.ndarray:
        """Return the state of the reference at rest, (3, n)."""
        return self._simulation._reference_now.reshape(3, -1).copy()

    def _tried(
        self, rng: random.Random, goal: Goal, ahead: np.ndarray | None
    ) -> tuple[np.ndarray, int] | None:
        """Return the states of a goal, and how many it waits; None if it is refused."""
        asked = goal_of(goal.joints, goal.time_s, goal.orders)
        when = rng.choice(("now", "now", "later", "late"))
        waits = rng.randint(0, round(LATEST_S / self._timestep)) if when == "later" else 0
        if when == "late":
            rest = asked.after(rng.uniform(0, LATEST_S))
            if rest is None:
                return None
            asked = rest
        try:
            return self._simulation.states(asked, waits * self._timestep, ahead), waits
        except GoalError:
            return None

    def _follow(
        self, states: np.ndarray, stop: int, before: np.ndarray
    ) -> tuple[np.ndarray | None, np.ndarray]:
        """Follow states up to a step; return those to come, and the state where it ends."""
        simulation, was = self._simulation, self._simulation.joints
        passed, named = 0, np.ptp(states[:, 0], axis=0) > 0
        for count in simulation.pursue(states):
            moved = np.abs(simulation.joints - was)
            most = OVER * self._cell.speed_limits * (count - passed) * self._timestep
            self._complain(moved > most + TREMBLE_RAD, "moves too far between two samples")
            was, passed = simulation.joints, count
            trembles = np.abs(simulation.joints - states[count - 1, 0])
            self.trembled_deg = max(
                self.trembled_deg, float(np.degrees(trembles[~named].max(initial=0.0)))
            )
            self._complain((trembles > TREMBLE_RAD) & ~named, UNNAMED)
            if count >= stop:
                break
        given = np.concatenate([before[None], states[:passed]])
        ways, changes = np.moveaxis(np.abs(np.diff(given[:, :2], axis=0)), 1, 0) / self._timestep
        self._complain((ways > OVER * self._cell.speed_limits + 1e-9).any(axis=0), "jumps")
        too_fast = (changes > OVER * self._acceleration + 1e-6).any(axis=0)
        self._complain(too_fast, "changes its speed too fast")
        mean = (given[1:, 1] + given[:-1, 1]) / 2
        lies = np.abs(np.diff(given[:, 0], axis=0) / self._timestep - mean)
        self._complain(
            (lies > self._acceleration * self._timestep).any(axis=0), "has a speed that is not its"
        )
        return (None if passed >= len(states) else states[passed:]), given[-1]

    def _judge_unnamed(self, goal: Goal, state: np.ndarray, positions: np.ndarray) -> None:
        """Judge joints that a goal does not name: they brake from where they are, and stay."""
        brakes = state[1] ** 2 / (2 * self._acceleration)
        far = np.abs(positions - state[0]).max(axis=0)
        unnamed = np.array([name not in goal.joints for name in self._simulation.joint_names])
        self._complain((far > brakes + np.abs(state[1]) * self._timestep + 1e-9) & unnamed, UNNAMED)

    def _complain(self, bad: np.ndarray, what: str) -> None:
        self.wrong += [f"{self._simulation.joint_names[j]} {what}" for j in np.flatnonzero(bad)]
