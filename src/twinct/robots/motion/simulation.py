"""Dynamic simulation of both arms: servos with torque limits that follow a timed path."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from twinct.core.errors import MotionError, TargetRefusedError
from twinct.geometry import MM_PER_M, Floats, Pose
from twinct.geometry.wire import JointSample, PosePairs, Reached, places_m
from twinct.robots.cell import CellModel, Clearance, mujoco
from twinct.robots.motion.branches import SIDES
from twinct.robots.motion.gate import brake, gate_of
from twinct.robots.motion.guide import Guide
from twinct.robots.motion.kinematics import site_pose
from twinct.robots.motion.plan import MotionPlan
from twinct.robots.motion.reactive import Reactive
from twinct.robots.motion.reference import Reference
from twinct.robots.motion.servos import Servos, Standstill
from twinct.robots.motion.shutter import Shutter
from twinct.robots.motion.touch import Touch, touches
from twinct.robots.sections import Motion
from twinct.uncertainty import TrueCell

STANDING = 1e-9
"""Speed and acceleration, rad and s, below which the reference stands still, up to rounding."""

SATURATED = 0.999
"""Share of its torque limit above which a joint counts as saturated."""

SAMPLE_S = 0.02
"""Longest simulated time between two samples of the moving joints."""


@dataclass
class StepWatch:
    """Torques and speeds over the steps of one move.

    Attributes:
        torque_share: largest share of its torque limit that each joint used, (n,).
        speed_share: largest share of its published speed that each joint reached, (n,).
    """

    torque_share: Floats
    speed_share: Floats


class RobotSimulation:
    """Simulation of both arms, stepped by MuJoCo along a plan or from target to target.

    The motion has one owner at a time: the plan of the views, or whatever moved the arms last. Each
    motion other than the next view ends the plan of the views: the arms brake first, and further
    views are refused until ``restore`` or ``follow``. Every cycle of every motion passes one gate
    (``_step``), which stops the arms.

    MuJoCo holds the complete state: ``mjData.userdata`` stores the reference position, velocity
    and acceleration of the servos and a mark of the plan of the views, 0 once that plan has ended,
    and the plan uses MuJoCo's time. ``mjSTATE_INTEGRATION``, the plan and the targets therefore
    determine all further motion.

    Attributes:
        watch: torques and speeds over every step of the last move.
        on_joints: callback that receives the joints every ``SAMPLE_S`` of simulated time.
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
        """Start at rest in a plan's home configuration.

        Args:
            cell_model: robot cell.
            motion: scheme, trigger, tolerances, limits of the joint path.
            plan: plan to follow; with ``motion.scheme: reactive`` only its home is used. None
                waits for ``follow``.
            shutter: duration of an exposure; None for an instantaneous one.
            roll_free: whether source and panel may roll about their own axes on the path to a
                target outside the plan.
            true_cell: true geometry of the cell. Plan, trigger and clearance use the nominal
                ``cell_model``. None if the nominal model is exact.

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
        self._gate, self._touch = gate_of(cell_model, motion), Touch(cell_model)
        self._sample_steps = max(1, int(SAMPLE_S / self._model.opt.timestep + 1e-9))
        self._n = len(cell_model.joint_names)
        # Views into MuJoCo's memory, because looking them up takes as long as the gate's check.
        self._reference_now = self._data.userdata[: 3 * self._n]
        self._before = self._data.userdata[: 2 * self._n]
        self._servos = Servos(cell_model, homing=motion.trigger == "settled")
        self._standstill = Standstill(cell_model, motion.settle_speed_mm_s / MM_PER_M)
        self.watch = self._new_watch()
        self._of_views: MotionPlan | None = None  # the plan of the views
        self._plan: MotionPlan | None = None  # the plan that owns the motion
        self._begun_s = 0.0
        if plan is not None:
            self.follow(plan)

    def follow(self, plan: MotionPlan) -> None:
        """Reset to rest in a plan's home, and follow the plan from its start.

        Raises:
            MotionError: the plan belongs to another cell.
        """
        if plan.joint_names != self._cell.joint_names:
            raise MotionError(
                f"the plan is for another cell: it moves {', '.join(plan.joint_names)}, but this "
                f"cell has {', '.join(self._cell.joint_names)}"
            )
        reactive = self._motion.scheme == "reactive"
        self._of_views = self._plan = None if reactive else plan
        self._begun_s = 0.0
        self._guide = Guide(self._cell, self._motion, self._roll_free, plan.home)
        self._mark = 0.0 if reactive else float(int(plan.digest[:12], 16))
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:] = self._data.userdata[: self._n] = self._data.ctrl[:] = plan.home
        self._data.userdata[-1] = self._mark
        mujoco.mj_forward(self._model, self._data)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joint names with the prefix ``source_`` or ``detector_``, source first."""
        return self._cell.joint_names

    @property
    def time_s(self) -> float:
        """Simulated time."""
        return float(self._data.time)

    @property
    def joints(self) -> Floats:
        """Current joint positions, rad, (n,)."""
        return self._data.qpos.copy()

    @property
    def _unready_steps(self) -> int:
        """Steps from the end of the last exposure for which the detector takes no new image."""
        if not self._taken:
            return 0
        return self._shutter.interval_steps(self._model.opt.timestep) - self._open_steps - 1

    def close(self) -> None:
        """Free MuJoCo's memory; a closed simulation cannot be used."""
        del self._data, self._reference_now, self._before, self._reactive, self._clearance

    def restore(self, state: Floats) -> None:
        """Restore the exact state of a ``Reached.state``.

        Raises:
            MotionError: the state belongs to another cell or another plan.
        """
        size = mujoco.mj_stateSize(self._model, mujoco.mjtState.mjSTATE_INTEGRATION)
        state = np.asarray(state, dtype=np.float64)
        if state.shape != (size,):
            raise MotionError(
                f"the state has shape {state.shape}, but the states of this cell have ({size},)"
            )
        mujoco.mj_setState(self._model, self._data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
        if self._data.userdata[-1] not in (self._mark, 0.0):
            raise MotionError("this state belongs to a plan other than the current one")
        self._plan = self._of_views if self._data.userdata[-1] else None
        self._begun_s = 0.0
        mujoco.mj_step1(self._model, self._data)
        self._taken = True
        self._guide.forget()

    def move(
        self,
        view: int | None,
        target: PosePairs,
        on_step: Callable[[mujoco.MjData], None] | None = None,
    ) -> Reached:
        """Continue along the plan until the trigger of a view fires.

        With ``motion.scheme: reactive``, inverse kinematics starts from the current joints. For a
        target outside the plan, the arms brake, and a new plan starts where they come to rest. It
        ends the plan of the views.

        Args:
            view: number of the view in the plan; None for a target outside the plan.
            target: poses that the trigger compares with.
            on_step: called at every step, with kinematics up to date.

        Raises:
            TargetRefusedError: the target is out of reach, would cause a collision or was missed,
                the arms could not follow, or the gate stopped them. The first two leave the
                simulation unchanged.
        """
        self._view = view
        if self._motion.scheme == "reactive" or view is not None:
            self._guide.forget()
        if self._motion.scheme == "reactive":
            return self.drive(self._reactive.solve(self.joints, target), target, on_step)
        if view is None:
            lead = self._plan_from(partial(self._guide.to, target))
            return self._along(0, "the target", lead, on_step)
        plan = self._of_views
        if plan is None:
            raise MotionError("there is no plan to follow")
        if self._plan is not plan:
            raise TargetRefusedError(
                f"view {view}: the plan of the views has ended, because something else moved the "
                "arms: restore a stored state, or follow the plan again"
            )
        if not target.agrees(plan.targets[view]):
            raise TargetRefusedError(f"view {view}: this target is not the one in the plan")
        return self._along(view, f"view {view}", np.zeros((0, 3, self._n)), on_step)

    def home(self, on_step: Callable[[mujoco.MjData], None] | None = None) -> Reached:
        """Plan a path home from the current joints, and bring the arms to rest there.

        Args:
            on_step: called at every step, with kinematics up to date.

        Raises:
            TargetRefusedError: no path was found, and the simulation is unchanged; or the arms
                could not follow the path.
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
        """Continue along the plan until the trigger of a view fires.

        Args:
            view: number of the view in the plan.
            name: name of the view in messages.
            lead: states of the reference before the plan begins, (steps, 3, n).
            on_step: called at every step.
            settled: whether the trigger waits for rest; None for the setting ``motion.trigger``.
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
        shut = max(len(lead), self._unready_steps)
        if settled is None and self._motion.trigger == "settled":
            # Arms at rest for the previous view may already be within this view's tolerance.
            shut = max(shut, math.floor(exposures_s[view] / timestep) - taken)
        target, what = plan.targets[view], f"{name} was missed{self._cause(exposures_s[view])}"
        return self._run(rows.__getitem__, steps, target, what, on_step, shut, settled)

    def _cause(self, due_s: float) -> str:
        """Return the reason why a view that was due at a time may be missed, for messages."""
        late_ms = 1000 * (self.time_s - self._begun_s - due_s)
        late_ms += 1000 * self._unready_steps * self._model.opt.timestep
        if late_ms > 0 and self._taken:
            return (
                f" (it was due {late_ms:.1f} ms before the detector was ready again, "
                f"{self._shutter.limit})"
            )
        if self._motion.trigger == "settled":
            allowed_s = self._motion.settle_s
            after = "the planned time" if allowed_s is None else f"motion.settle_s = {allowed_s:g}"
            return f" (the arms were not at rest after {after})"
        return ""

    def _plan_from(self, make: Callable[[Floats], MotionPlan]) -> Floats:
        """Make a plan from the joints at which the arms come to rest, and follow it from there.

        Args:
            make: makes a plan from joint positions, rad, (n,).

        Returns:
            States of the reference until the plan begins, (steps, 3, n).

        Raises:
            TargetRefusedError: no plan was found; nothing is changed.
        """
        lead = self._to_rest()
        here = lead[-1, 0] if len(lead) else self._data.userdata[: self._n].copy()
        self._own(make(here))
        self._begun_s = self.time_s + len(lead) * self._model.opt.timestep
        return lead

    def _own(self, plan: MotionPlan | None) -> None:
        """Make a plan other than that of the views the owner of the motion; None for no plan."""
        self._plan, self._data.userdata[-1] = plan, 0.0

    def _to_rest(self) -> Floats:
        """Return the states of a reference that brakes until it stands still, (steps, 3, n)."""
        now, timestep = self._data.userdata[: 3 * self._n].reshape(3, -1), self._model.opt.timestep
        return brake(now, self._gate.jumps[1] / timestep, timestep)

    def brake(self) -> None:
        """Bring the arms to rest, whatever is in the way; this ends the plan of the views."""
        self._own(None)
        for state in self._to_rest():  # keeps the gate's limits
            self._control(state)
            if self.on_joints is not None:
                self._sample(self.on_joints)

    def drive(
        self,
        goal: Floats,
        target: PosePairs,
        on_step: Callable[[mujoco.MjData], None] | None = None,
    ) -> Reached:
        """Move straight towards joint positions until the trigger fires for ``target``.

        Args:
            goal: joint positions, rad, (n,).
            target: poses that the trigger compares with.
            on_step: called at every step, with kinematics up to date.

        Raises:
            TargetRefusedError: the arms did not arrive within ``motion.timeout_s``, or the gate
                stopped them.
        """
        self._own(None)
        n, timestep = self._n, self._model.opt.timestep
        path = self._reference.towards(self._data.userdata[: 3 * n].reshape(3, n), goal)
        shut = self._unready_steps
        steps = shut + round(self._motion.timeout_s / timestep)
        what = f"the arms did not arrive within {self._motion.timeout_s:g} s of simulated time"
        return self._run(lambda k: path.at((k + 1) * timestep), steps, target, what, on_step, shut)

    def _run(
        self,
        reference: Callable[[int], Floats],
        steps: int,
        target: PosePairs,
        what: str,
        on_step: Callable[[mujoco.MjData], None] | None,
        shut: int = 0,
        settled: bool | None = None,
    ) -> Reached:
        """Follow a reference until the trigger fires, for at most ``steps`` steps.

        The trigger cannot fire within the first ``shut`` steps.
        """
        model, data, motion, n = self._model, self._data, self._motion, self._n
        wanted = places_m(target).reshape(2, 3)
        # Views into MuJoCo's memory, because looking them up costs as much as a step.
        spots = [data.site_xpos[site] for site in self._cell.site_ids]
        joints, speeds, torques = data.qpos, data.qvel, data.qfrc_actuator
        tolerance_m = motion.tolerance_mm / MM_PER_M
        settled = motion.trigger == "settled" if settled is None else settled
        open_steps = self._open_steps
        record = np.zeros((steps + open_steps + 1, 3, n))
        instants: list[PosePairs] = []
        watch = self.watch = self._new_watch()
        mujoco.mj_step1(model, data)
        self._touch.begin(data)
        last = self._view - 1 if self._view else None
        before = self._instant(last) if self._shutter.remember and self._taken else None
        for step in range(steps + open_steps + 1):
            record[step, 0], record[step, 1], record[step, 2] = joints, speeds, torques
            if on_step is not None:
                on_step(data)
            if self.on_joints is not None and step:
                self._sample(self.on_joints)
            to_source, to_detector = spots[0] - wanted[0], spots[1] - wanted[1]
            near = max(to_source @ to_source, to_detector @ to_detector) < tolerance_m**2
            # The state before the first step belongs to the move before.
            opens = step > shut and near and (not settled or self._at_rest())
            if instants or opens:
                instants.append(self._instant(self._view))
                if len(instants) > open_steps:
                    self._judge(watch, record[: step + 1])
                    self._taken = True
                    return self._reached(record[: step + 1], instants, before)
            elif step >= steps:
                break
            try:
                self._step(reference(step))
            except TargetRefusedError as stopped:
                self._judge(watch, record[: step + 1])
                text = "; ".join([str(stopped), *self._saturated()])
                raise TargetRefusedError(text, stopped.arms) from None
        self._judge(watch, record)
        raise self._late(wanted, what)

    def _sample(self, tell: Callable[[JointSample], None]) -> None:
        """Pass a joint sample to the callback if the time is on the grid of samples."""
        if round(self._data.time / self._model.opt.timestep) % self._sample_steps == 0:
            self._tell(tell)

    def _tell(self, tell: Callable[[JointSample], None]) -> None:
        """Pass a joint sample to the callback."""
        data = self._data
        now = data.qpos.copy(), data.qvel.copy(), data.qfrc_actuator.copy()
        tell(JointSample(float(data.time), self.joint_names, *now))

    def _step(self, state: Floats) -> None:
        """Let a reference pass the gate, and step the servos once towards it.

        Whatever moves an arm comes through here in each cycle.

        Args:
            state: position, velocity and acceleration, rad and s, (3, n).

        Raises:
            TargetRefusedError: the reference jumps or leaves the limits of the joints, or bodies
                touch; the arms have come to rest.
        """
        if not self._gate.admits(self._before, state[:2].ravel()):
            reason = self._gate.reason(self._before.reshape(2, -1), state[None])
            if reason is not None:
                self._stop(reason, (reason,))  # it begins with the joint
        self._control(state)
        if (pair := self._touch.made(self._data)) is not None:
            self._stop(touches(pair), pair, release=True)

    def _stop(self, reason: str, names: tuple[str, ...], *, release: bool = False) -> None:
        """Bring the arms to rest, and raise the reason as ``TargetRefusedError``.

        Args:
            reason: what the gate refuses.
            names: names of joints or bodies, which begin with the names of their arms.
            release: whether the arms then rest where they stand, without pressing on a body.
        """
        view = "" if self._view is None else f"view {self._view}: "
        self.brake()
        if release:
            rest = np.zeros((3, self._n))
            rest[0] = self.joints
            self._control(rest)
        arms = [side for side in SIDES if any(name.startswith(side) for name in names)]
        raise TargetRefusedError(f"{view}{reason}; the arms were stopped", arms)

    def _control(self, state: Floats) -> None:
        """Step the servos once towards a position, velocity and acceleration, (3, n)."""
        model, data = self._model, self._data
        self._servos.command(data, state)
        self._reference_now[:] = state.ravel()
        mujoco.mj_step2(model, data)
        mujoco.mj_step1(model, data)

    def _judge(self, watch: StepWatch, record: Floats) -> None:
        """Store the largest speed and torque shares; the first instant belongs to the last move."""
        _, speed, torque = np.abs(record[1:]).max(axis=0, initial=0.0)
        watch.speed_share = speed / self._cell.speed_limits
        watch.torque_share = torque / self._cell.torque_limits

    def _new_watch(self) -> StepWatch:
        return StepWatch(np.zeros(self._n), np.zeros(self._n))

    def _at_rest(self) -> bool:
        """Check that the reference has stopped and both end-effectors stand still."""
        if np.abs(self._data.userdata[self._n : 3 * self._n]).max() > STANDING:
            return False
        return self._standstill.at(self._data)

    def _instant(self, view: int | None) -> PosePairs:
        data, body = self._data, self._cell.specimen_body
        source, detector = (site_pose(data, site).as_sent() for site in self._cell.site_ids)
        quat = np.roll(data.xquat[body], -1)
        stands = Pose.from_seven((*data.xpos[body].tolist(), *quat.tolist()))
        nominal = PosePairs((source,), (detector,), (stands,))
        if self._true_cell is None:
            return nominal
        return self._true_cell.at(
            nominal, view, float(data.time), data.qpos, data.qvel, self._planned_accelerations
        )

    def _planned_accelerations(self, times: Floats) -> Floats:
        """Return the planned accelerations at some simulated times, (times, n)."""
        if self._plan is None:
            return np.zeros((len(times), self._n))
        return self._plan.at(times - self._begun_s)[:, 2]

    def _reached(
        self, record: Floats, instants: list[PosePairs], before: PosePairs | None
    ) -> Reached:
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
        """Return the error of a timeout: the arms' distances and saturated joints."""
        here = self._data.site_xpos[list(self._cell.site_ids)]
        off_mm = np.linalg.norm(here - wanted, axis=1) * MM_PER_M
        parts = [
            f"{what}: source and detector are {off_mm[0]:.1f} and {off_mm[1]:.1f} mm off their "
            f"targets ({self._motion.tolerance_mm:g} mm allowed)"
        ]
        parts += self._saturated()
        late = np.flatnonzero(off_mm >= self._motion.tolerance_mm)
        return TargetRefusedError("; ".join(parts), [SIDES[arm] for arm in late])

    def _saturated(self) -> list[str]:
        """Return a part of a message about joints that reached their torque limit, if any."""
        at_limit = np.flatnonzero(self.watch.torque_share >= SATURATED)
        names, limits = self.joint_names, self._cell.torque_limits
        limited = [f"{names[joint]} ({limits[joint]:.0f} N m)" for joint in at_limit]
        return [f"torque limit reached in {', '.join(limited)}"] if limited else []
