"""Simulation of both arms that also follows the joint trajectories of a foreign planner."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from twinct.core.errors import MotionError
from twinct.geometry import Floats
from twinct.geometry.wire import PosePairs, Reached
from twinct.robots.motion.joint_goal import ArmLimits, JointGoal, states_of
from twinct.robots.motion.kinematics import mujoco
from twinct.robots.motion.refusals import readable
from twinct.robots.motion.simulation import RobotSimulation

JUMP_DEG = 0.5
"""Largest distance from the arms to the first point of a foreign trajectory, deg."""


class PursuingSimulation(RobotSimulation):
    """``RobotSimulation`` that takes a trajectory of joints instead of a target, too."""

    @property
    def timestep_s(self) -> float:
        """Simulated time of a step."""
        return float(self._model.opt.timestep)

    @property
    def instant(self) -> PosePairs:
        """Present poses of source, specimen and panel."""
        return self._instant(None)

    def states(self, goal: JointGoal) -> Floats:
        """Return the states of a foreign trajectory, from where the arms come to rest.

        Raises:
            GoalError: the arms cannot follow it; nothing is changed.
        """
        lead, model, n = self._to_rest(), self._model, self._n
        here = lead[-1, 0] if len(lead) else self._data.userdata[:n].copy()
        limits = ArmLimits(self.joint_names, model.jnt_range[:n], self._cell.speed_limits)
        rows = states_of(goal, here, limits, model.opt.timestep, np.radians(JUMP_DEG))
        return np.concatenate([lead, rows])

    def pursue(self, states: Floats) -> Iterator[int]:
        """Follow states; yield the number of those passed, at each sample of the joints.

        A caller that stops early calls ``brake``.

        Raises:
            MotionError: bodies touch.
        """
        self._view = None
        self._guide.forget()
        mujoco.mj_step1(self._model, self._data)
        for count, state in enumerate(states, start=1):
            self._step(state)
            if self._data.ncon:
                geoms = self._data.contact[0].geom
                first, second = (readable(self._cell.body_of_geom(int(g))) for g in geoms)
                raise MotionError(f"{first} touches {second}")
            if self.on_joints is not None:
                self._sample(self.on_joints)
            if count % self._sample_steps == 0 or count == len(states):
                yield count

    def brake(self) -> None:
        """Bring the arms to rest, whatever is in the way."""
        now = self._data.userdata[: 3 * self._n].reshape(3, -1).copy()
        path, timestep = self._reference.towards(now, now[0]), self._model.opt.timestep
        for step in range(1, math.ceil(path.duration / timestep) + 1):
            self._step(path.at(step * timestep))
            if self.on_joints is not None:
                self._sample(self.on_joints)

    def stand(self) -> Reached:
        """Take a view where the arms stand.

        Raises:
            TargetRefusedError: they do not come to rest.
        """
        self._view = None
        lead, n = self._to_rest(), self._n
        rest = np.zeros((3, n))
        rest[0] = lead[-1, 0] if len(lead) else self._data.userdata[:n]
        steps = len(lead) + math.ceil(self._motion.timeout_s / self._model.opt.timestep)
        spots = [self._data.site_xpos[site].tolist() for site in self._cell.site_ids]
        source, detector = ((*spot, 0.0, 0.0, 0.0, 1.0) for spot in spots)
        shut = max(len(lead), self._unready_steps)
        return self._run(
            lambda step: lead[step] if step < len(lead) else rest,
            *(steps, PosePairs.from_sevens([(source, detector)]), "the exposure", None, shut, True),
        )
