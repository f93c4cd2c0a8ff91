"""The robot simulation as a ROS 2 node: ``/scan/target`` in, ``/scan/reached`` out.

The service ``/scan/home`` returns the arms to their start.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from geometry_msgs.msg import PoseArray
from numpy.typing import NDArray
from std_msgs.msg import String
from std_srvs.srv import Trigger

from twinct.core.errors import MotionError
from twinct.geometry.wire import JointSample, PosePairs, Reached, targets_of
from twinct.link import messages
from twinct.link.arm_server import ArmServer
from twinct.link.arm_types import ACTION, FRAMES, installed, lack
from twinct.link.frames import Frames
from twinct.link.joint_trajectory import PlanListener
from twinct.link.messages import MalformedError
from twinct.link.node import (
    LISTENERS,
    NO_STAMP,
    Diagnostics,
    Ledger,
    RefusedError,
    run_node,
)
from twinct.link.participant import Station
from twinct.link.senders import Members, Sender
from twinct.link.stamps import Epoch, Stamp
from twinct.link.topics import (
    CLOCK,
    DESCRIPTION,
    EXPOSE,
    HOME,
    JOINTS,
    REACHED,
    ROBOTS,
    SCAN,
    STATE,
    TARGET,
    VIEWS,
)
from twinct.robots.motion import MotionPlan, PursuingSimulation
from twinct.scan import SimulationBuilder
from twinct.scenario import Scenario
from twinct.version import __version__

if TYPE_CHECKING:
    from twinct.robots.cell import LinkFrames

KEPT = 100
"""Number of answers stored for repeated targets of a running scan."""

TICK_S = 0.02
"""Longest simulated time between two clock messages."""

BEAT_S = 0.05
"""Wall time, and simulated time, from beat to beat of a standalone node at rest: 20 Hz."""


class Robots(Protocol):
    """Protocol of a ``RobotSimulation`` or ``Gantry``, as far as the node needs it."""

    on_joints: Callable[[JointSample], None] | None

    def follow(self, plan: MotionPlan) -> None:
        """Take a plan to follow, and start in its home."""

    def move(self, view: int | None, target: PosePairs) -> Reached:
        """Bring both end-effectors to a target; ``view`` is its view in a plan, if any."""
        ...

    def home(self) -> Reached:
        """Return both end-effectors to rest at their start."""
        ...

    def idle(self, seconds: float) -> float:
        """Let simulated time pass at rest, and return it."""
        ...

    def restore(self, state: NDArray[np.float64]) -> None:
        """Continue from a state."""

    def close(self) -> None:
        """Release all resources."""


def spin_robots(
    scenario: Scenario,
    *,
    epoch: str | None = None,
    first_view: int = 0,
    planned: bool = False,
    restore: Path | None = None,
    specimen: Path | None = None,
    members: Members | None = None,
    lifeline: bool = False,
    build: Callable[[], Robots] | None = None,
) -> int:
    """Run the robot simulation as a node until SIGINT or SIGTERM.

    Args:
        scenario: scenario to simulate.
        epoch: epoch of the scan whose targets alone are accepted, in order; None: any target.
        first_view: first view of that scan.
        planned: take the plan from ``/scan/plan``; else make it here.
        restore: ``.npy`` file with the simulator state to start from.
        specimen: file of the built specimen; None builds it.
        members: members of that scan.
        lifeline: also end when stdin ends.
        build: builds a simulation in place of the real one.

    Returns:
        Exit code: 0.
    """
    turns = None if epoch is None else _turns(scenario, epoch, first_view)
    state = np.load(restore) if restore is not None else None
    description: str | None = None
    links: LinkFrames | None = None

    def build_simulation() -> Robots:
        nonlocal description, links
        if build is not None:
            robots = build()
        else:
            builder = SimulationBuilder.with_specimen(scenario, specimen)
            robots = builder.robots(planned=planned)
            if scenario.cell.kind != "gantry":
                from twinct.robots.cell import LinkFrames

                description, links = builder.urdf(), LinkFrames(builder.cell)
        if state is not None and not planned:
            robots.restore(state)
        return robots

    def open_node(station: Station, diagnostics: Diagnostics, robots: Robots) -> Callable[[], bool]:
        node = RobotsNode(station, diagnostics, robots, turns, members, description, links)
        node.start_beats()
        if not planned or members is None:
            return node.connected

        def take(plan: MotionPlan) -> None:
            robots.follow(plan)
            if turns is not None:
                turns.expect(plan.targets)
            if state is not None:
                robots.restore(state)

        plan = PlanListener(station, diagnostics, members, take)
        return lambda: plan.taken and node.connected()

    data = {"scenario": scenario.resolved(), "version": __version__}
    common: dict[str, Any] = {"lifeline": lifeline, "members": members, "parameters": data}
    return run_node(ROBOTS, build_simulation, open_node, **common)


def _turns(scenario: Scenario, epoch: str, first_view: int) -> Turns:
    targets = targets_of(SimulationBuilder(scenario).requested)
    return Turns(Epoch.parse(epoch), targets, first_view)


class Turns:
    """Targets of one scan, accepted in order."""

    def __init__(self, epoch: Epoch, targets: Sequence[PosePairs], first: int) -> None:
        """Expect the views of a scan, starting with ``first``."""
        self._epoch, self._targets, self._next = epoch, targets, first

    def view(self, stamp: Stamp) -> int | None:
        """Return the view of a stamp; None for a stamp of another scan."""
        view = self._epoch.view(stamp)
        return view if view is not None and view < len(self._targets) else None

    def check(self, stamp: Stamp, target: PosePairs) -> None:
        """Check that a target is the next one of the scan.

        Raises:
            RefusedError: the target is not the next one.
        """
        view = self.view(stamp)
        running = "a scan is running"
        if view is None:
            raise RefusedError(f"{running}, and the stamp of this target does not belong to it")
        if not target.agrees(self._targets[view]):
            raise RefusedError(
                f"{running}, and this target differs from the scan's target for view {view}"
            )
        if view != self._next:
            raise RefusedError(f"{running}: view {self._next} comes next, not view {view}")

    def expect(self, targets: Sequence[PosePairs]) -> None:
        """Replace the targets by a plan's, which may differ in order and roll."""
        self._targets = targets

    def __len__(self) -> int:
        """Return the number of views of the scan."""
        return len(self._targets)

    def done(self) -> None:
        """Expect the next view."""
        self._next += 1

    def last(self, stamp: Stamp) -> bool:
        """Return True for the stamp of the view before the expected one."""
        return self.view(stamp) == self._next - 1


class RobotsNode:
    """Node that executes each target once, and returns the arms home on request."""

    def __init__(
        self,
        station: Station,
        diagnostics: Diagnostics,
        robots: Robots,
        turns: Turns | None = None,
        members: Members | None = None,
        description: str | None = None,
        links: LinkFrames | None = None,
    ) -> None:
        """Create the endpoints; from now on, targets are executed."""
        self._robots, self._turns, self._members = robots, turns, members
        # A refusal by the robots is stored as an answer, too, so that it is not retried.
        self._ledger: Ledger[Stamp, PosePairs, Reached | RefusedError] = Ledger(
            keep=None if turns is None else KEPT
        )
        self._station, self._diagnostics = station, diagnostics
        self._clock_s: float | None = None
        self._clock = station.publisher(CLOCK)
        self._views = station.publisher(VIEWS, depth=max(VIEWS.depth, 4 * len(turns or ())))
        self._reached = station.publisher(REACHED)
        self._joints = station.publisher(JOINTS)
        self._state = station.publisher(STATE)
        if description is not None:
            self._description = station.publisher(DESCRIPTION)
            self._description.publish(String(data=description))
        self._frames: Frames | None = None
        arms = robots if isinstance(robots, PursuingSimulation) else None
        if links is not None and arms is not None and installed(FRAMES):
            self._frames = Frames(station, links, len(arms.joints))
            self._instant = lambda: arms.instant
        robots.on_joints = self._on_joints
        self._targets = station.listen_to_all(TARGET, self._on_target)
        station.serve(HOME, Trigger, self._on_home)
        self._arms: ArmServer | None = None
        if turns is None and arms is not None:
            if lacking := lack(FRAMES, ACTION):
                diagnostics.tell(lacking)
            if installed(ACTION):
                self._arms = ArmServer(station, diagnostics, arms, self._advance)
            station.serve(EXPOSE, Trigger, partial(self._on_expose, arms))
            still = np.zeros(len(arms.joints))
            rest = JointSample(arms.time_s, arms.joint_names, arms.joints, still, still)
            self._on_joints(rest)  # who joins learns where the arms stand before they move

    def connected(self) -> bool:
        """Return True if the scan's rig and X-ray node are connected, or there is no scan."""
        if self._members is not None and not self._members.knows(SCAN):
            return False
        return self._turns is None or (
            all(heard.get_publisher_count() for heard in self._targets)
            and self._reached.get_subscription_count() > LISTENERS
            and self._views.get_subscription_count() > 1
            and bool(self._joints.get_subscription_count())
            and bool(self._state.get_subscription_count())
        )

    def start_beats(self) -> None:
        """Beat in wall time from now on; in a scan nothing moves, and no time passes, unasked."""
        if self._turns is None and self._members is None:
            self._station.every(BEAT_S, self.beat)

    def beat(self) -> None:
        """Let time pass at rest, and publish clock, joints and frames."""
        if self._arms is not None and self._arms.busy:
            return
        try:
            self._advance(self._robots.idle(BEAT_S))
        except MotionError as error:
            values = {"arm": ", ".join(error.arms), "reason": error}
            self._diagnostics.refuse(NO_STAMP, f"stopped: {error}", values)

    def _on_target(self, message: PoseArray, sender: Sender) -> None:
        stamp = Stamp.of(message.header.stamp)
        try:
            target = messages.target_of(message)
            answer = self._ledger.find(stamp, target)
            if answer is None:
                self._admit(stamp, target)
                answer = self._execute(stamp, target)
            elif isinstance(answer, Reached) and (self._turns is None or self._turns.last(stamp)):
                # The message may have been dropped from a full queue. A scan's queue holds all
                # views for late joiners; the scan repeats only its last target.
                self._tell_view(stamp, answer)
            if isinstance(answer, RefusedError):
                raise answer
        except (RefusedError, MalformedError) as refused:
            self._refuse(stamp, message, sender, refused)
        else:
            self._answer(answer)

    def _admit(self, stamp: Stamp, target: PosePairs) -> None:
        """Check that a target may be executed: in a scan its next one, whoever requests it."""
        self._check_free()
        if self._turns is not None:
            self._turns.check(stamp, target)

    def _check_free(self) -> None:
        if self._arms is not None and self._arms.busy:
            raise RefusedError("the arms follow a joint trajectory: wait for its end, or cancel it")

    def _execute(self, stamp: Stamp, target: PosePairs) -> Reached | RefusedError:
        answer: Reached | RefusedError
        try:
            answer = self._robots.move(self._view(stamp), target)
        except MotionError as error:
            answer = RefusedError(str(error), error.arms)
        else:
            view = self._view(stamp)
            if self._turns is not None:
                self._turns.done()
            # Before all messages with this stamp.
            self._advance(answer.time_s)
            self._tell_view(stamp, answer)
            self._diagnostics.tell(
                f"reached {stamp if view is None else f'view {view}'}: simulated time "
                f"{answer.time_s:.3f} s, {answer.clearance_in_words}"
            )
        self._ledger.enter(stamp, target, answer)
        return answer

    def _view(self, stamp: Stamp) -> int | None:
        return self._turns.view(stamp) if self._turns is not None else None

    def _tell_view(self, target: Stamp, reached: Reached) -> None:
        stamp = Stamp.at(reached.middle_s)
        self._views.publish(messages.view_message(stamp, target, self._view(target)))

    def _answer(self, reached: Reached) -> None:
        # The poses first: they trigger the image.
        poses = messages.executed(reached)
        self._reached.publish(messages.reached_message(Stamp.at(reached.middle_s), poses))
        self._tell_state(reached)

    def _tell_state(self, reached: Reached) -> None:
        stamp = Stamp.at(reached.middle_s)
        self._joints.publish(messages.joints_message(stamp, reached))
        self._state.publish(messages.state_message(stamp, reached))
        if self._frames is not None:
            self._frames.tell(stamp, reached.position, reached.executed)

    def _on_joints(self, joints: JointSample) -> None:
        self._advance(joints.time_s)
        self._joints.publish(messages.joints_message(Stamp.at(joints.time_s), joints))
        # A scan does not wait for frames that nobody hears; each of its views tells them anyway.
        if self._frames is not None and (self._turns is None or self._frames.heard):
            self._frames.tell(Stamp.at(joints.time_s), joints.position, self._instant())

    def _advance(self, time_s: float) -> None:
        """Advance the clock to a time, unless it is already there."""
        start_s = time_s - TICK_S if self._clock_s is None else self._clock_s
        ticks = max(0, math.ceil((time_s - start_s) / TICK_S - 1e-9))
        for tick_s in np.linspace(start_s, time_s, ticks + 1)[1:].tolist():
            self._clock.publish(messages.clock_message(tick_s))
        self._clock_s = max(start_s, time_s)

    def _on_home(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        del request  # it is empty
        try:
            if self._turns is not None:
                raise RefusedError("a scan is running, and only the scan may move the arms")
            self._check_free()
            reached = self._robots.home()
        except (MotionError, RefusedError) as refused:
            response.message = str(refused)
            values = {"arm": ", ".join(refused.arms), "reason": refused}
            self._diagnostics.refuse(NO_STAMP, f"home refused: {refused}", values)
        else:
            response.success = True
            response.message = (
                f"at home: simulated time {reached.time_s:.3f} s, {reached.clearance_in_words}"
            )
            # No poses: they would trigger an image.
            self._advance(reached.time_s)
            self._tell_state(reached)
            self._diagnostics.tell(response.message)
        return response

    def _on_expose(
        self, robots: PursuingSimulation, _: Trigger.Request, response: Trigger.Response
    ) -> Trigger.Response:
        """Take a view where the arms stand; the message is its stamp."""
        try:
            self._check_free()
            reached = robots.stand()
        except (MotionError, RefusedError) as refused:
            response.message = str(refused)
            values = {"arm": ", ".join(refused.arms), "reason": refused}
            self._diagnostics.refuse(NO_STAMP, f"exposure refused: {refused}", values)
            return response
        stamp = Stamp.at(reached.middle_s)
        self._advance(reached.time_s)
        self._tell_view(stamp, reached)
        self._answer(reached)
        response.success, response.message = True, str(stamp)
        return response

    def _refuse(self, stamp: Stamp, message: PoseArray, sender: Sender, refused: Exception) -> None:
        view = self._view(stamp)
        values: dict[str, object] = {
            "view": "" if view is None else view,
            "arm": ", ".join(getattr(refused, "arms", ())),
            "reason": refused,
            "target": describe(message),
            "asked_by": sender.participant,
        }
        name = stamp if view is None else f"of view {view}"
        self._diagnostics.refuse(stamp, f"target {name} refused: {refused}", values)


def describe(message: PoseArray) -> str:
    """Return the poses of a message as text, to distinguish targets."""
    return "; ".join(" ".join(map(repr, messages.numbers_of(pose))) for pose in message.poses)
