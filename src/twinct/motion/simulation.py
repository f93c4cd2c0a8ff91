"""The dynamic simulation of both arms: servos within torque limits that follow a timed path."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from twinct.cell import CellModel, Clearance
from twinct.errors import MotionError, TargetRefusedError
from twinct.geometry import MM_PER_M, Floats
from twinct.motion.branches import SIDES
from twinct.motion.guide import Guide
from twinct.motion.kinematics import mujoco, site_pose
from twinct.motion.plan import MotionPlan
from twinct.motion.reactive import Reactive
from twinct.motion.reference import Reference
from twinct.motion.refusals import readable
from twinct.motion.shutter import Shutter
from twinct.scenario import Motion
from twinct.uncertainty import TrueCell
from twinct.views import Instant, JointSample, Reached, Target, to_seven

BREAKAWAY_RAD_S = 0.002
"""Speed from which a joint's dry friction is compensated in full."""

STANDING = 1e-9
"""Speed and acceleration, rad and s, below which the reference stands still but for rounding."""

SATURATED = 0.999
"""Share of its torque limit from which a joint counts as at the limit."""

SAMPLE_S = 0.02
"""Simulated time from one sample of the moving joints to the next, at most."""


@dataclass
class StepWatch:
    """What happened over the steps of one move.

    Attributes:
        torque_share: largest share of its torque limit that each joint used, (n,).
        speed_share: largest share of its published speed that each joint had, (n,).
        contacts: pairs of bodies that touched.
    """

    torque_share: Floats
    speed_share: Floats
    contacts: set[tuple[str, str]]


class RobotSimulation:
    """Both arms, stepped by MuJoCo along a plan, or from target to target.

    The state is MuJoCo's alone: the reference position, velocity and acceleration of the servos are
    kept in ``mjData.userdata`` with a mark of the plan, whose time is MuJoCo's, so
    ``mjSTATE_INTEGRATION`` is all there is, and what follows is a function of it, of the plan and
    of the targets.

    Attributes:
        watch: torques, speeds and contacts over every step of the last move.
        on_joints: hears of the joints every ``SAMPLE_S``, on a grid of the simulated time.
    """

    on_joints: Callable[[JointSample], None] | None = None

    def __init__(
        self,
        cell_model: CellModel,
        motion: Motion,
        plan: MotionPlan | None,
        shutter: Shutter | None = None,
        roll_free: tuple[bool, bool] = (False, False),
        true_cell: TrueCell | None = None,
    ) -> None:
        """Start at rest in a plan's home.

        Args:
            cell_model: the room.
            motion: scheme, trigger, tolerances, limits of the joint path.
            plan: what is followed; with ``motion.scheme: reactive`` its home alone counts. None
                waits for ``follow``.
            shutter: how long an image takes; none: no time.
            roll_free: whether source and panel may be turned about their own axis on the way to a
                target of no plan.
            true_cell: where everything really is. The model here is the nominal one: plan, trigger
                and clearance go by it. None: it is the truth.

        Raises:
            MissingExtraError: MuJoCo, mink or Ruckig is not installed.
        """
        self._cell, self._motion, self._model = cell_model, motion, cell_model.model
        self._shutter, self._roll_free = shutter or Shutter(), roll_free
        self._open_steps = self._shutter.steps(self._model.opt.timestep)
        self._true_cell = true_cell
        self._view: int | None = None
        self._taken = False
        self._data = mujoco.MjData(self._model)
        self._reactive = Reactive(cell_model, motion)
        self._reference = Reference(cell_model, motion)
        self._clearance = Clearance(cell_model)
        self._sample_steps = max(1, int(SAMPLE_S / self._model.opt.timestep + 1e-9))
        self._n = len(cell_model.joint_names)
        self._stiffness = self._model.actuator_gainprm[: self._n, 0].copy()
        # The servo's own damping and the joint's friction both pull back a moving joint.
        self._drag = self._model.dof_damping - self._model.actuator_biasprm[: self._n, 2]
        self._dry_friction = self._model.dof_frictionloss
        self._jacobian = np.zeros((3, self._model.nv))
        self._feedforward = np.zeros(self._model.nv)
        self.watch = self._new_watch()
        self._plan: MotionPlan | None = None
        self._begun_s = 0.0
        if plan is not None:
            self.follow(plan)

    def follow(self, plan: MotionPlan) -> None:
        """Stand at rest in a plan's home, to follow it from its beginning.

        Raises:
            MotionError: it is of another cell.
        """
        if plan.joint_names != self._cell.joint_names:
            raise MotionError(
                f"the plan is of another cell: it moves {', '.join(plan.joint_names)}, this cell "
                f"has {', '.join(self._cell.joint_names)}"
            )
        self._plan, self._begun_s = plan, 0.0
        self._guide = Guide(self._cell, self._motion, self._roll_free, plan.home)
        self._mark = 0.0 if self._motion.scheme == "reactive" else float(int(plan.digest[:12], 16))
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:] = self._data.userdata[: self._n] = self._data.ctrl[:] = plan.home
        self._data.userdata[-1] = self._mark
        mujoco.mj_forward(self._model, self._data)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Prefixed ``source_`` and ``detector_``, source first."""
        return self._cell.joint_names

    @property
    def time_s(self) -> float:
        """Simulated time."""
        return float(self._data.time)

    @property
    def joints(self) -> Floats:
        """Joint positions now, rad, (n,)."""
        return self._data.qpos.copy()

    def close(self) -> None:
        """Free what MuJoCo holds; a closed simulation cannot be used."""
        del self._data, self._reactive, self._clearance

    def restore(self, state: Floats) -> None:
        """Go back exactly to ``Reached.state``.

        Raises:
            MotionError: the state is of another cell or of another plan.
        """
        size = mujoco.mj_stateSize(self._model, mujoco.mjtState.mjSTATE_INTEGRATION)
        state = np.asarray(state, dtype=np.float64)
        if state.shape != (size,):
            raise MotionError(
                f"a state of shape {state.shape} is not of this cell, whose states have ({size},)"
            )
        mujoco.mj_setState(self._model, self._data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
        if self._data.userdata[-1] != self._mark:
            raise MotionError("this state is of another plan than the one that is followed")
        mujoco.mj_step1(self._model, self._data)
        self._taken = True
        self._guide.forget()

    def move(
        self,
        view: int | None,
        target: Target,
        on_step: Callable[[mujoco.MjData], None] | None = None,
    ) -> Reached:
        """Go on along the plan until the trigger of a view fires.

        With ``motion.scheme: reactive`` the target is solved from the joints as they are. To a
        target of no plan one is made from where the arms come to rest, and followed from then on.

        Args:
            view: its number in the plan; None for a target that is in none.
            target: the poses that the trigger compares with.
            on_step: called at every step, with kinematics up to date.

        Raises:
            TargetRefusedError: out of reach, would collide, missed, or the arms could not follow.
                The first two leave the simulation as it was.
        """
        self._view = view
        if self._motion.scheme == "reactive" or view is not None:
            self._guide.forget()
        if self._motion.scheme == "reactive":
            return self.drive(self._reactive.solve(self.joints, target), target, on_step)
        if view is None:
            lead = self._plan_from(partial(self._guide.to, target))
            return self._along(0, "the target", lead, on_step)
        if self._plan is None:
            raise MotionError("there is no plan to follow")
        if target != self._plan.targets[view]:
            raise TargetRefusedError(f"view {view}: this target is not the one of the plan")
        return self._along(view, f"view {view}", np.zeros((0, 3, self._n)), on_step)

    def home(self, on_step: Callable[[mujoco.MjData], None] | None = None) -> Reached:
        """Bring the arms to rest where they started, by a way planned from where they are.

        Args:
            on_step: called at every step, with kinematics up to date.

        Raises:
            TargetRefusedError: there is no way, which leaves the simulation as it was; or the arms
                could not follow it.
        """
        self._view = None
        lead = self._plan_from(self._guide.home)
        return self._along(0, "home", lead, on_step, settled=True)

    def _along(
        self,
        view: int,
        name: str,
        lead: Floats,
        on_step: Callable[[mujoco.MjData], None] | None,
        settled: bool | None = None,
    ) -> Reached:
        """Go on along the plan until a view's trigger fires.

        Args:
            view: its number in the plan.
            name: what messages call it.
            lead: states of the reference that come before the plan begins, (steps, 3, n).
            on_step: called at every step.
            settled: whether the trigger waits for rest; None: as ``motion.trigger`` says.
        """
        plan, timestep = self._plan, self._model.opt.timestep
        assert plan is not None
        taken = round((self.time_s - self._begun_s) / timestep)
        exposures_s = plan.exposures_s
        if view + 1 < len(exposures_s):
            armed_to_s = (exposures_s[view] + exposures_s[view + 1]) / 2
        else:
            armed_to_s = plan.duration_s + self._motion.timeout_s
        steps = max(0, math.floor(armed_to_s / timestep) - taken)
        rows = plan.at((taken + np.arange(1, steps + self._open_steps + 2)) * timestep)
        rows[: len(lead)] = lead
        shut = len(lead)
        if settled is None and self._motion.trigger == "settled":
            # At rest for the view before, arms may stand within the next one's tolerance.
            shut = max(shut, math.floor(exposures_s[view] / timestep) - taken)
        target, what = plan.targets[view], f"{name} was missed"
        return self._run(rows.__getitem__, steps, target, what, on_step, shut, settled)

    def _plan_from(self, make: Callable[[Floats], MotionPlan]) -> Floats:
        """Make a plan from where the arms come to rest the one that is followed.

        Args:
            make: makes it, from joint positions, rad, (n,).

        Returns:
            States of the reference until the plan begins, (steps, 3, n).

        Raises:
            TargetRefusedError: there is no such plan; nothing is changed.
        """
        lead = self._to_rest()
        here = lead[-1, 0] if len(lead) else self._data.userdata[: self._n].copy()
        self._plan = make(here)
        self._begun_s = self.time_s + len(lead) * self._model.opt.timestep
        return lead

    def _to_rest(self) -> Floats:
        """States of the reference until it stands still, (steps, 3, n)."""
        now, timestep = self._data.userdata[: 3 * self._n].reshape(3, -1), self._model.opt.timestep
        if np.abs(now[1:]).max() <= STANDING:
            return np.zeros((0, 3, self._n))
        if self._motion.scheme == "planned" and self._plan is not None:
            since_s = self.time_s - self._begun_s
            steps = math.ceil((self._plan.duration_s - since_s) / timestep)
            return self._plan.at(since_s + np.arange(1, steps + 1) * timestep)
        path = self._reference.towards(now, now[0])
        steps = math.ceil(path.duration / timestep)
        return np.array([path.at(k * timestep) for k in range(1, steps + 1)])

    def drive(
        self, goal: Floats, target: Target, on_step: Callable[[mujoco.MjData], None] | None = None
    ) -> Reached:
        """Move to joint positions, unchecked, until the trigger fires for ``target``.

        Args:
            goal: joint positions, rad, (n,).
            target: the poses that the trigger compares with.
            on_step: called at every step, with kinematics up to date.

        Raises:
            TargetRefusedError: the arms did not arrive within ``motion.timeout_s``.
        """
        n, timestep = self._n, self._model.opt.timestep
        path = self._reference.towards(self._data.userdata[: 3 * n].reshape(3, n), goal)
        steps = round(self._motion.timeout_s / timestep)
        what = f"cannot follow: after {self._motion.timeout_s:g} s of simulated time"
        return self._run(lambda k: path.at((k + 1) * timestep), steps, target, what, on_step)

    def _run(
        self,
        reference: Callable[[int], Floats],
        steps: int,
        target: Target,
        what: str,
        on_step: Callable[[mujoco.MjData], None] | None,
        shut: int = 0,
        settled: bool | None = None,
    ) -> Reached:
        """Follow a reference until the trigger fires, for so many steps at most.

        It cannot fire within the first ``shut`` of them.
        """
        model, data, motion, n = self._model, self._data, self._motion, self._n
        wanted = np.array([target.source_m[:3], target.detector_m[:3]])
        # Views of MuJoCo's memory: looking them up at every step costs as much as the step.
        spots = [data.site_xpos[site] for site in self._cell.site_ids]
        joints, speeds, torques = data.qpos, data.qvel, data.qfrc_actuator
        tolerance_m = motion.tolerance_mm / MM_PER_M
        settled = motion.trigger == "settled" if settled is None else settled
        open_steps = self._open_steps
        record = np.zeros((steps + open_steps + 1, 3, n))
        instants: list[Instant] = []
        watch = self.watch = self._new_watch()
        mujoco.mj_step1(model, data)
        last = self._view - 1 if self._view else None
        before = self._instant(last) if self._shutter.remember and self._taken else None
        for step in range(steps + open_steps + 1):
            record[step, 0], record[step, 1], record[step, 2] = joints, speeds, torques
            if data.ncon:
                for contact in data.contact:
                    first, second = sorted(self._cell.body_of_geom(int(g)) for g in contact.geom)
                    watch.contacts.add((first, second))
            if on_step is not None:
                on_step(data)
            if self.on_joints is not None and step:
                self._sample(self.on_joints)
            to_source, to_detector = spots[0] - wanted[0], spots[1] - wanted[1]
            near = max(to_source @ to_source, to_detector @ to_detector) < tolerance_m**2
            # What a move finds before its first step is the last one's doing.
            opens = step > shut and near and (not settled or self._at_rest())
            if instants or opens:
                instants.append(self._instant(self._view))
                if len(instants) > open_steps:
                    self._judge(watch, record[: step + 1])
                    self._taken = True
                    return self._reached(record[: step + 1], instants, before)
            elif step >= steps:
                break
            self._step(reference(step))
        self._judge(watch, record)
        raise self._late(wanted, what)

    def _sample(self, tell: Callable[[JointSample], None]) -> None:
        """Tell of the joints where the time is on the samples' grid."""
        data = self._data
        if round(data.time / self._model.opt.timestep) % self._sample_steps == 0:
            now = data.qpos.copy(), data.qvel.copy(), data.qfrc_actuator.copy()
            tell(JointSample(float(data.time), self.joint_names, *now))

    def _step(self, state: Floats) -> None:
        """One step of the servos towards position, velocity and acceleration, (3, n)."""
        model, data, n = self._model, self._data, self._n
        position, velocity, acceleration = state
        mujoco.mj_mulM(model, data, self._feedforward, acceleration)
        data.userdata[: 3 * n] = state.ravel()
        dry_friction = self._dry_friction * np.tanh(velocity / BREAKAWAY_RAD_S)
        torque = self._feedforward + self._drag * velocity + dry_friction
        data.ctrl[:] = position + torque / self._stiffness
        mujoco.mj_step2(model, data)
        mujoco.mj_step1(model, data)

    def _judge(self, watch: StepWatch, record: Floats) -> None:
        """Largest speeds and torques; those of the first instant belong to the move before."""
        _, speed, torque = np.abs(record[1:]).max(axis=0, initial=0.0)
        watch.speed_share = speed / self._cell.speed_limits
        watch.torque_share = torque / self._cell.torque_limits

    def _new_watch(self) -> StepWatch:
        return StepWatch(np.zeros(self._n), np.zeros(self._n), set())

    def _at_rest(self) -> bool:
        """The reference has stopped and both end-effectors stand still."""
        if np.abs(self._data.userdata[self._n : 3 * self._n]).max() > STANDING:
            return False
        limit = self._motion.settle_speed_mm_s / MM_PER_M
        for site in self._cell.site_ids:
            mujoco.mj_jacSite(self._model, self._data, self._jacobian, None, site)
            if np.linalg.norm(self._jacobian @ self._data.qvel) > limit:
                return False
        return True

    def _instant(self, view: int | None) -> Instant:
        data, body = self._data, self._cell.specimen_body
        source, detector = (to_seven(site_pose(data, site)) for site in self._cell.site_ids)
        quat = np.roll(data.xquat[body], -1)
        told = Instant(source, (*data.xpos[body].tolist(), *quat.tolist()), detector)
        if self._true_cell is None:
            return told
        return self._true_cell.at(told, view, float(data.time), data.qpos, data.qvel)

    def _reached(self, record: Floats, instants: list[Instant], before: Instant | None) -> Reached:
        model, data, timestep = self._model, self._data, self._model.opt.timestep
        middle, exposure = self._shutter.over(instants, timestep)
        joints = self._shutter.middle(record[-len(instants) :], timestep)
        size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_INTEGRATION)
        state = np.zeros(size)
        mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
        return Reached(
            executed=middle,
            joint_names=self._cell.joint_names,
            position=joints[0].copy(),
            velocity=joints[1].copy(),
            effort=joints[2].copy(),
            state=state,
            time_s=float(data.time),
            clearance_mm=self._clearance.over(record[:, 0]).distance_mm,
            exposure=exposure,
            before=before,
            since_middle_s=self._open_steps * timestep - self._shutter.middle_s,
        )

    def _late(self, wanted: Floats, what: str) -> TargetRefusedError:
        """Where the arms are when their time is over, and what holds them."""
        here = self._data.site_xpos[list(self._cell.site_ids)]
        off_mm = np.linalg.norm(here - wanted, axis=1) * MM_PER_M
        parts = [
            f"{what}: source and detector are {off_mm[0]:.1f} and {off_mm[1]:.1f} mm off their "
            f"targets ({self._motion.tolerance_mm:g} mm allowed)"
        ]
        at_limit = np.flatnonzero(self.watch.torque_share >= SATURATED)
        names, limits = self.joint_names, self._cell.torque_limits
        limited = [f"{names[joint]} ({limits[joint]:.0f} N m)" for joint in at_limit]
        if limited:
            parts.append(f"torque limit reached in {', '.join(limited)}")
        for first, second in sorted(self.watch.contacts):
            parts.append(f"{readable(first)} touches {readable(second)}")
        late = np.flatnonzero(off_mm >= self._motion.tolerance_mm)
        return TargetRefusedError("; ".join(parts), [SIDES[arm] for arm in late])
