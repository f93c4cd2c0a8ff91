"""Legal joint trajectories of a foreign planner, one after the other.

Each moves the joints that it names, and no other. The judge of what is legal shares no code with
twinct's gate: it samples the interpolation of SciPy against the limits.
"""

from __future__ import annotations

import random
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.interpolate

from twinct.robots.cell import CellModel, Clearance
from twinct.robots.motion import PursuingSimulation, goal_of

MOVED_DEG = 0.01
"""Largest distance between the rests of a joint that a goal does not name."""

LARGEST_RAD = 0.4
"""Largest way of a joint from point to point."""

SHARES = (0.3, 0.95)
"""Share of its limits that a goal uses."""

CLEAR_MM = 5.0
"""Gap that a goal keeps: a joint that touches something may be pushed."""

ROUNDING_MM = 0.5
"""Way by which a gap may shrink at the start of a goal."""

SETTLED_S = 0.5
"""Time after which servos at rest are off by less than 0.002 deg; they converge in 0.1 s."""

SAMPLES = 400
"""Samples by which a goal is judged."""

FORMS = ("line", "cubic", "quintic")


@dataclass(frozen=True)
class Goal:
    """A goal that the limits allow: fields of a trajectory."""

    joints: tuple[str, ...]
    time_s: list[float]
    orders: tuple[list[Any], list[Any], list[Any]]
    told: str


class Goals:
    """Maker of legal goals for a cell.

    Attributes:
        acceleration: largest acceleration, rad/s^2.
    """

    def __init__(self, cell: CellModel, acceleration_deg_s2: float) -> None:
        """Use the limits of a cell."""
        self._names, self._ranges = cell.joint_names, cell.joint_ranges
        self._speeds, self._clearance = cell.speed_limits, Clearance(cell)
        self.acceleration = float(np.radians(acceleration_deg_s2))

    def draw(self, rng: random.Random, here: np.ndarray) -> Goal:
        """Return a random goal from a configuration at rest, rad, (n,)."""
        while (goal := self._tried(rng, here)) is None:
            pass
        return goal

    def _tried(self, rng: random.Random, here: np.ndarray) -> Goal | None:
        chosen = rng.sample(range(len(here)), rng.choice((1, 1, 2, 3, 6, len(here))))
        form, points = rng.choice(FORMS), rng.randint(1, 4)
        steps = np.array([[rng.uniform(-1, 1) for _ in chosen] for _ in range(points)])
        position = here[chosen] + np.cumsum(LARGEST_RAD * steps, axis=0)
        spans = np.array([rng.uniform(0.5, 2) for _ in range(points)])
        velocity, acceleration = (
            np.array([[size * rng.uniform(-1, 1) for _ in chosen] for _ in range(points)])
            for size in (0.2, 0.5)
        )
        velocity[-1] = 0.0
        time = np.concatenate([[0.0], np.cumsum(spans)])
        rest = np.zeros((1, len(chosen)))
        path = [np.vstack([here[None, chosen], position])]
        path += [np.vstack([rest, order]) for order in (velocity, acceleration)]
        count = 1 + FORMS.index(form)
        between = scipy.interpolate.BPoly.from_derivatives(time, np.stack(path[:count], axis=1))
        at = np.linspace(0, time[-1], SAMPLES)
        shares = [
            np.abs(between.derivative()(at)).max(axis=0) / self._speeds[chosen],
            # The corners of lines are rounded within the limit.
            np.zeros(1)
            if form == "line"
            else np.sqrt(np.abs(between.derivative(2)(at)).max(axis=0) / self.acceleration),
        ]
        slower = max(share.max() for share in shares) / rng.uniform(*SHARES)
        low, high = self._ranges[chosen].T
        on_way = np.tile(here, (SAMPLES, 1))
        on_way[:, chosen] = between(at)
        if not ((on_way[:, chosen] > low) & (on_way[:, chosen] < high)).all():
            return None
        # Arms that braked may stand nearer to something than any goal leads.
        least_mm = min(CLEAR_MM, self._clearance.over(here[None]).distance_mm - ROUNDING_MM)
        if self._clearance.over(on_way[::8]).distance_mm < least_mm:
            return None
        first = 0 if rng.random() < 0.3 else 1  # the present, stated or not
        orders = [order[first:] / slower**power for power, order in enumerate(path)]
        names = tuple(self._names[joint] for joint in chosen)
        stated = [order.tolist() for order in orders[:count]]
        return Goal(
            names,
            (time[first:] * slower).tolist(),
            (stated[0], *(stated[1:] + [[], []])[:2]),
            f"{form} of {len(chosen)} joints through {points} points",
        )


class Chain:
    """Goals, exposures and cancels, one after the other, without a pause in which arms may rest.

    Attributes:
        followed: number of goals.
        moved_deg: largest distance between the rests of a joint that no goal named since.
        trembled_deg: largest distance while other joints moved.
    """

    def __init__(self, simulation: PursuingSimulation, goals: Goals) -> None:
        """Start with the arms at rest."""
        self._simulation, self._goals = simulation, goals
        self._expected = simulation.joints
        self.followed, self.moved_deg, self.trembled_deg = 0, 0.0, 0.0

    def follow(self, rng: random.Random, *, cancel: bool = False) -> None:
        """Follow a goal, and perhaps cancel it."""
        goal = self._goals.draw(rng, self._expected)
        states = self._simulation.states(goal_of(goal.joints, goal.time_s, goal.orders))
        stop = rng.randrange(len(states)) if cancel else len(states) + 1
        named = np.array([name in goal.joints for name in self._simulation.joint_names])
        self._compare(states[:, 0], named)
        for passed in self._simulation.pursue(states):
            off = np.degrees(np.abs(self._simulation.joints - self._expected))
            self.trembled_deg = max(self.trembled_deg, float(off[~named].max(initial=0.0)))
            if passed >= stop:
                self._simulation.brake()
                break
        self._expected[named] = states[-1, 0, named]
        if cancel:
            self._simulation.idle(SETTLED_S)
            self._expected[named] = self._simulation.joints[named]
        self.followed += 1

    def expose(self) -> None:
        """Take a view, for which no joint moves."""
        self._simulation.stand()

    def end(self) -> None:
        """Let the arms rest, and compare all joints with where they were sent last."""
        self._simulation.idle(SETTLED_S)
        self._compare(self._simulation.joints[None], np.zeros(len(self._expected), bool))

    def _compare(self, positions: np.ndarray, named: np.ndarray) -> None:
        off = np.degrees(np.abs(positions - self._expected)).max(axis=0)
        off[named] = 0.0
        self.moved_deg = max(self.moved_deg, float(off.max()))
        if not self.moved_deg <= MOVED_DEG:
            worst = self._simulation.joint_names[int(off.argmax())]
            raise AssertionError(f"{worst} moves by {off.max():.4f} deg, but is not named")
