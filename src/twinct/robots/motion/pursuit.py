"""Simulation of both arms that also follows the joint trajectories of a foreign planner."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from twinct.geometry import Floats
from twinct.geometry.wire import PosePairs, Reached
from twinct.robots.cell import mujoco
from twinct.robots.motion.joint_goal import JointGoal, states_of
from twinct.robots.motion.simulation import RobotSimulation


class PursuingSimulation(RobotSimulation):
    """``RobotSimulation`` that takes a trajectory of joints instead of a target, too."""

    @property
    def instant(self) -> PosePairs:
        """Present poses of source, specimen and panel."""
        return self._instant(None)

    @property
    def velocities(self) -> Floats:
        """Current joint velocities, rad/s, (n,)."""
        return self._data.qvel.copy()

    @property
    def patience_s(self) -> float:
        """Simulated time for which a motion may be late at its end."""
        return self._motion.timeout_s

    def states(self, goal: JointGoal, wait_s: float = 0.0, ahead: Floats | None = None) -> Floats:
        """Return the states of a foreign trajectory, from where the arms come to rest.

        Args:
            goal: the trajectory.
            wait_s: time until it starts, for which the arms rest.
            ahead: states to come of the trajectory that it replaces, (steps, 3, n): the arms follow
                these until it starts, and go over to it as they move. None: nothing is followed.

        Returns:
            States up to rest, (steps, 3, n).

        Raises:
            GoalError: the gate refuses it; nothing is changed.
        """
        waits = round(wait_s / self._model.opt.timestep)
        lead = self._to_rest() if ahead is None else ahead[:waits]
        now = lead[-1] if len(lead) else self._reference_now.reshape(3, -1).copy()
        if ahead is None:
            now[1:] = 0.0
        rows = states_of(goal, now, self._gate)
        # Whoever waits beyond the end of the lead rests there.
        waiting = np.repeat(now[None], max(waits - len(lead), 0), axis=0)
        return np.concatenate([lead, waiting, rows])

    def _rest_after(self, lead: Floats) -> Floats:
        """Return the state of rest after the states of a reference that brakes, (3, n)."""
        rest = np.zeros((3, self._n))
        rest[0] = lead[-1, 0] if len(lead) else self._data.userdata[: self._n]
        return rest

    def _begin(self) -> None:
        """Begin a motion of no plan, which ends the plan of the views."""
        self._view = None
        self._own(None)
        mujoco.mj_step1(self._model, self._data)
        self._touch.begin(self._data)

    def pursue(self, states: Floats) -> Iterator[int]:
        """Follow states; yield the number of those passed, at each sample of the joints.

        A caller that stops early calls ``brake``.

        Raises:
            TargetRefusedError: the gate stopped the arms.
        """
        self._begin()
        self._guide.forget()
        for count, state in enumerate(states, start=1):
            self._step(state)
            if self.on_joints is not None:
                self._sample(self.on_joints)
            if count % self._sample_steps == 0 or count == len(states):
                yield count

    def idle(self, seconds: float) -> float:
        """Let simulated time pass; arms that move come to rest, which ends the plan of the views.

        The joints are told once, at the end.

        Args:
            seconds: simulated time.

        Returns:
            simulated time at the end.

        Raises:
            TargetRefusedError: the gate stopped the arms.
        """
        self._begin()
        lead = self._to_rest()
        rest = self._rest_after(lead)
        for step in range(max(1, round(seconds / self._model.opt.timestep))):
            self._step(lead[step] if step < len(lead) else rest)
        if self.on_joints is not None:
            self._tell(self.on_joints)
        return self.time_s

    def stand(self) -> Reached:
        """Bring the arms to rest, and take a view there.

        Raises:
            TargetRefusedError: they do not come to rest, or the gate stopped them.
        """
        self._view = None
        self._own(None)
        lead = self._to_rest()
        rest = self._rest_after(lead)
        steps = len(lead) + math.ceil(self._motion.timeout_s / self._model.opt.timestep)
        spots = [self._data.site_xpos[site].tolist() for site in self._cell.site_ids]
        source, detector = ((*spot, 0.0, 0.0, 0.0, 1.0) for spot in spots)
        shut = max(len(lead), self._unready_steps)
        return self._run(
            lambda step: lead[step] if step < len(lead) else rest,
            *(steps, PosePairs.from_sevens([(source, detector)]), "the exposure", None, shut, True),
        )
