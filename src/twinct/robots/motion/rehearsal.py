"""Rehearsal of a motion with rests: how long the servos need to come to rest after each stretch."""

from __future__ import annotations

import numpy as np

from twinct.geometry import MM_PER_M, Floats
from twinct.robots.cell import CellModel, mujoco
from twinct.robots.motion.servos import Servos, Standstill
from twinct.robots.motion.timing import FINE_S
from twinct.robots.sections import Motion

LONGEST_S = 0.35
"""Longest rest for servos: 1 mm off, critically damped at 80 rad/s, they rest after 0.1 s."""

SPARE_S = 0.02
"""Rest beyond that of the rehearsal, which does not follow the waypoints to the last digit."""


class Rehearsal:
    """Servos of the nominal cell, as they follow stretch after stretch."""

    def __init__(self, cell: CellModel, motion: Motion, home: Floats) -> None:
        """Start at rest.

        Args:
            cell: robot cell.
            motion: speed at which the end-effectors count as at rest.
            home: joint positions, rad, (n,).
        """
        self._cell, self._data = cell, mujoco.MjData(cell.model)
        self._data.qpos[:] = self._data.ctrl[:] = home
        mujoco.mj_forward(cell.model, self._data)
        self._servos = Servos(cell, homing=True)
        self._standstill = Standstill(cell, motion.settle_speed_mm_s / MM_PER_M)

    def settles_s(self, states: Floats, least_s: float, rest_s: float) -> float:
        """Follow a stretch and rest; return the time at rest after which a view can be exposed.

        Args:
            states: states of the reference from rest to rest, at steps of ``FINE_S``, (times, 3,
                n).
            least_s: least time at rest, for other reasons.
            rest_s: time at rest after that.
        """
        step_s, longest = self._cell.model.opt.timestep, max(LONGEST_S, least_s)
        duration_s = FINE_S * (len(states) - 1)
        at = np.arange(1, round(duration_s / step_s) + 1) * step_s / FINE_S
        for state in states[np.minimum(np.rint(at).astype(int), len(states) - 1)]:
            self._step(state)
        rest, rests_since = states[-1], 0
        steps = int(np.ceil(longest / step_s))
        needs = steps
        for step in range(steps):
            self._step(rest)
            rests_since = rests_since + 1 if self._standstill.at(self._data) else 0
            # Servos that come back swing through a standstill, but do not stay there.
            if rests_since * step_s >= SPARE_S and step * step_s >= least_s:
                needs = step
                break
        for _ in range(int(np.ceil(rest_s / step_s))):
            self._step(rest)
        return needs * step_s

    def _step(self, state: Floats) -> None:
        self._servos.command(self._data, state)
        mujoco.mj_step2(self._cell.model, self._data)
        mujoco.mj_step1(self._cell.model, self._data)
