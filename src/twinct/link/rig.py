"""The rig over ROS 2: two node processes, from which this process requests view by view."""

from __future__ import annotations

import logging
import os
import shutil
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray
from numpy.typing import NDArray
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState

from twinct.core.errors import LinkError, MemoryShortageError, TargetRefusedError
from twinct.core.files.private import temporary_folder
from twinct.core.memory import SHORTAGE
from twinct.geometry.wire import JointSample, PosePairs, Reached
from twinct.link import environment, messages
from twinct.link.arm_types import FRAMES, lack
from twinct.link.environment import Domain
from twinct.link.joint_trajectory import publish_plan
from twinct.link.messages import ERROR, OK, MalformedError
from twinct.link.node import LISTENERS, Diagnostics, speaker_of
from twinct.link.participant import Station
from twinct.link.processes import NodeProcess
from twinct.link.robots_node import describe
from twinct.link.senders import Members, Sender
from twinct.link.stamps import Epoch, Stamp
from twinct.link.tap import Heard, Tap
from twinct.link.topics import (
    DIAGNOSTICS,
    IMAGE,
    JOINTS,
    REACHED,
    ROBOTS,
    SCAN,
    STATE,
    TARGET,
    VIEWS,
    XRAY,
    Topic,
)
from twinct.scenario import Scenario, stage_digests
from twinct.specimen.built_file import save_built

if TYPE_CHECKING:
    from twinct.robots.motion import MotionPlan
    from twinct.scan import SimulationBuilder
    from twinct.specimen import BuiltSpecimen

log = logging.getLogger(__name__)

# -P: import no modules from the current folder, which may be a stranger's.
NODE_COMMAND = (sys.executable, "-P", "-m", "twinct.link")
START_S = 900.0
"""Time limit for both nodes to build their simulations."""
ANSWER_S = 600.0
"""Time limit for one answer, against endless work; dead or hung nodes are noticed sooner."""
FIRST_REPEAT_S, LONGEST_REPEAT_S = 2.0, 60.0
"""First and longest silence before a target is sent again; the silence doubles each time."""


def ros_rigs(
    log_dir: Path | None = None,
    domain: Domain | None = None,
    hear: Callable[[Heard], object] | None = None,
) -> Callable[[SimulationBuilder, int, NDArray[np.float64] | None], RosRig]:
    """Return a factory of rigs over ROS 2, with the signature of ``twinct.scan.local_rig``.

    Args:
        log_dir: folder for the nodes' output; None for a temporary one.
        domain: domain held for the scan; None takes one when the rig is made.
        hear: called with all messages of the scan's processes, in a separate thread.
    """
    common: dict[str, Any] = {"log_dir": log_dir, "domain": domain, "hear": hear}
    return lambda builder, first_view, start_state: RosRig(
        builder.scenario,
        plan=builder.plan,
        specimen=builder.specimen,
        first_view=first_view,
        start_state=start_state,
        **common,
    )


class RosRig:
    """A ``Rig`` whose two simulations are ROS 2 nodes in separate processes.

    Attributes:
        domain_id: ROS domain of this scan, and of no other on this machine.
        epoch: origin of its stamps.
        log_dir: folder with ``robots.log`` and ``xray.log``.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        plan: MotionPlan | None = None,
        specimen: BuiltSpecimen | None = None,
        first_view: int = 0,
        start_state: NDArray[np.float64] | None = None,
        log_dir: Path | None = None,
        domain: Domain | None = None,
        node_command: Sequence[str] = NODE_COMMAND,
        answer_s: float = ANSWER_S,
        hear: Callable[[Heard], object] | None = None,
    ) -> None:
        """Start both nodes and wait until they are at work.

        Args:
            scenario: scenario to simulate.
            plan: plan for the arms; with None, the robots node makes one.
            specimen: the built specimen; with None, each node builds it.
            first_view: first view that will be requested.
            start_state: simulator state to start from; None for the planned home.
            log_dir: folder for the nodes' output; None for a temporary one.
            domain: domain held for this scan, and closed with the rig; None takes
                ``ROS_DOMAIN_ID`` or, if that is not set, a free domain.
            node_command: starts a node when ``robots`` or ``xray`` and the options are appended.
            answer_s: time limit for one answer.
            hear: called with all messages of this process and the nodes, in a separate thread.

        Raises:
            MissingExtraError: rclpy is not installed.
            InputError: the requested domain is in use, or invalid.
            LinkError: a node did not start.
        """
        environment.require_ros()
        environment.settle(os.environ)
        self.epoch = Epoch.of(stage_digests(scenario)["images"])
        self._answer_s = answer_s
        self._samples = scenario.source.motion_samples
        self._shape = scenario.detector.panel.shape
        # Time at which each target was reached, and the messages for each such time.
        self._taken: dict[Stamp, Stamp] = {}
        self._got: dict[Stamp, dict[Topic, Any]] = {}
        self._joints_until = Stamp(0, 0)
        self._sent_target: tuple[int, Stamp, PoseArray] | None = None
        self._ready: set[str] = set()
        self._refusal: TargetRefusedError | None = None
        self._conflict: str | None = None
        self._nodes: list[NodeProcess] = []
        self._ended: list[NodeProcess] = []
        self._station: Station | None = None
        self._closing = False
        self._tell_joints: Callable[[JointSample], None] | None = None
        self._teardown = ExitStack()
        with ExitStack() as stack:
            domain = domain or Domain()
            stack.callback(domain.close)
            environment.sweep_shared_memory()
            stack.callback(environment.sweep_shared_memory)
            self.domain_id = domain.id
            folder = stack.enter_context(temporary_folder())
            self.log_dir = folder if log_dir is None else log_dir
            self.log_dir.mkdir(parents=True, exist_ok=True)
            stack.callback(self._stop_nodes)
            exchange = folder / "exchange"
            exchange.mkdir()
            self._members = Members(exchange)
            start = ["--first-view", str(first_view), *(["--planned"] if plan else [])]
            if start_state is not None:
                np.save(exchange / "start.npy", start_state)
                start += ["--restore", str(exchange / "start.npy")]
            both = ["--lifeline"]
            if specimen is not None:
                save_built(specimen, exchange / "specimen.npz")
                both += ["--specimen", str(exchange / "specimen.npz")]
            options = {"robots": [*both, *start], "xray": both}
            self._start_nodes(scenario.resolved(), exchange, domain, options, node_command)
            station = self._station = Station(SCAN, self.domain_id)
            stack.callback(station.close)
            self._members.enter(SCAN, station.participant)
            self._members.knows(SCAN)  # while the folder exists
            self._diagnostics = Diagnostics(station, log.warning)
            if hear is not None:
                stack.callback(Tap(self.domain_id, self._members, hear, self._foreign).close)
            if scenario.cell.kind == "arms" and (lacking := lack(FRAMES)):
                log.warning(lacking)
            if plan:
                self._plan = publish_plan(station, self.epoch.at(0), plan)
            self._open(station, arms=scenario.cell.kind == "arms")
            shutil.rmtree(exchange)  # everyone has read it; it must not outlive a killed parent
            self._teardown = stack.pop_all()

    def _start_nodes(
        self,
        scenario: str,
        folder: Path,
        domain: Domain,
        options: Mapping[str, Sequence[str]],
        command: Sequence[str],
    ) -> None:
        file = folder / "scenario.json"
        file.write_text(scenario, encoding="utf-8")
        scan = ["--epoch", str(self.epoch), "--members", str(folder)]
        common = [str(file), *scan]
        variables = environment.without_system_ros(os.environ) | {"ROS_DOMAIN_ID": str(domain.id)}
        for name, own in options.items():
            process = NodeProcess(
                name,
                [*command, name, *common, *own],
                self.log_dir / f"{name}.log",
                environment=variables,
                inherit=[domain.hold],
                beats=True,
                on_end=self._on_node_end,
            )
            self._nodes.append(process)

    def _on_node_end(self, ended: NodeProcess) -> None:
        """Stop the other node, and wake this process, which notices the end in its next wait."""
        self._ended.append(ended)
        for node in self._nodes:
            if node is not ended:
                node.request_stop()
        if self._station is not None:
            self._station.wake()

    def _open(self, station: Station, *, arms: bool) -> None:
        self._target = station.publisher(TARGET)
        joints = partial(messages.checked_joints, arms=arms)
        state = partial(messages.checked_state, arms=arms)
        heard = [
            self._hear(station, VIEWS, lambda message: Stamp.of(message.time_ref)),
            self._hear(station, REACHED, self._poses_of),
            self._hear(station, JOINTS, lambda message: self._moving(joints(message))),
            self._hear(station, STATE, state),
            self._hear(station, IMAGE, lambda message: messages.image_of(message, self._shape)),
        ]
        station.listen(DIAGNOSTICS, self._on_diagnostics)

        def connected() -> bool:
            return (
                self._ready >= {ROBOTS, XRAY}
                and self._target.get_subscription_count() >= LISTENERS
                and all(subscription.get_publisher_count() for subscription in heard)
            )

        if not station.wait(lambda: self._broken() or connected(), START_S):
            raise LinkError(f"the nodes were not ready {START_S:.0f} s after their start")
        self._check()

    def _hear(self, station: Station, topic: Topic, read: Callable[[Any], Any]) -> Subscription:
        """Subscribe to a topic, and store its messages, which are all from its owner."""

        def keep(message: Any, sender: Sender) -> None:
            if not self._members.has(topic.owner, sender.participant):
                self._foreign(topic)
                return
            of_state = topic == STATE
            stamp = messages.state_stamp(message) if of_state else Stamp.of(message.header.stamp)
            try:
                if stamp is not None:
                    self._keep(topic, stamp, read(message))
            except MalformedError as error:
                view = "" if self._sent_target is None else f" of view {self._sent_target[0]}"
                self._conflict = f"{topic.name}{view}: {error}"

        return station.listen(topic, keep)

    def _foreign(self, topic: Topic) -> None:
        """End the scan: a topic has a second publisher."""
        self._conflict = self._diagnostics.stranger(topic, self._members)

    def _keep(self, topic: Topic, stamp: Stamp, what: Any) -> None:
        if topic == VIEWS:
            self._taken[what] = stamp
        else:
            self._got.setdefault(stamp, {})[topic] = what

    def _answer(self) -> dict[Topic, Any]:
        """Return the data received for the last target, by topic."""
        taken = self._taken.get(self._sent_target[1]) if self._sent_target else None
        return self._got.get(taken, {}) if taken else {}

    def _moving(self, message: JointState) -> JointState:
        """Forward the joint state, each instant once."""
        stamp = Stamp.of(message.header.stamp)
        if self._tell_joints is not None and message.name and stamp > self._joints_until:
            self._tell_joints(messages.joints_of(message))
        self._joints_until = max(stamp, self._joints_until)
        return message

    def _poses_of(self, message: PoseArray) -> PosePairs:
        poses = messages.executed_of(message)
        messages.parts_of(poses, self._samples)
        return poses

    def _on_diagnostics(self, message: DiagnosticArray, _: Sender) -> None:
        who = speaker_of(message)
        name = next((n for n in (ROBOTS, XRAY) if self._members.has(n, who)), "")
        for status in message.status if name else ():
            values = messages.diagnostic_values(status.values)
            if status.level == OK:
                self._ready.add(name)
            elif status.level == ERROR and "topic" in values:  # which has a foreign publisher
                self._conflict = status.message
            elif status.level == ERROR and self._sent_target is not None:
                view, stamp, target = self._sent_target
                if stamp != Stamp.of(message.header.stamp):
                    continue
                if name == XRAY:
                    self._conflict = status.message
                elif values.get("target") == describe(target):
                    arms = [arm for arm in values.get("arm", "").split(", ") if arm]
                    reason = values.get("reason", status.message)
                    self._refusal = TargetRefusedError(f"view {view}: {reason}", arms)

    def _broken(self) -> bool:
        return self._conflict is not None or bool(self._ended)

    def _check(self) -> None:
        if self._ended:  # the first node to end stops the other
            words, code = self._ended[0].describe_end(), self._ended[0].exit_code
            if code == MemoryShortageError.exit_code and SHORTAGE in words:
                raise MemoryShortageError(words)
            raise LinkError(words)
        if self._conflict is not None:
            raise LinkError(self._conflict)

    def _wait(self, what: str, done: Callable[[], bool]) -> None:
        """Wait for an answer to the last target; repeat the target while none comes."""
        if self._station is None or self._closing or self._sent_target is None:
            raise LinkError("the rig is closed")
        view, _, message = self._sent_target
        deadline = time.monotonic() + self._answer_s
        silence = FIRST_REPEAT_S
        while True:
            left = deadline - time.monotonic()
            if self._station.wait(lambda: self._broken() or done(), min(silence, max(left, 0.0))):
                break
            if time.monotonic() >= deadline:
                late = f"no {what} for view {view} within {self._answer_s:.0f} s"
                raise LinkError("; ".join([late, *self._diagnostics.strangers.values()]))
            silence = min(2 * silence, LONGEST_REPEAT_S)
            self._target.publish(message)
        self._check()

    def move(self, view: int, target: PosePairs) -> Reached:
        """See ``Rig.move``."""
        if self._closing:
            raise LinkError("the rig is closed")
        stamp = self.epoch.at(view)
        self._refusal = None
        self._sent_target = view, stamp, messages.target_message(stamp, target)
        self._got = {self._taken[stamp]: self._answer()} if stamp in self._taken else {}
        self._target.publish(self._sent_target[2])

        def done() -> bool:
            return self._refusal is not None or self._answer().keys() >= {REACHED, JOINTS, STATE}

        self._wait("reached poses", done)
        if self._refusal is not None:
            raise self._refusal
        got = self._answer()
        return messages.reached_of(got[REACHED], got[JOINTS], got[STATE], self._samples)

    def expose(self, view: int) -> NDArray[np.float32]:
        """See ``Rig.expose``."""
        if self._sent_target is None or self._sent_target[0] != view or self._refusal is not None:
            raise ValueError(f"view {view} was not reached: move before you expose")
        self._wait("image", lambda: IMAGE in self._answer())
        return self._answer()[IMAGE]

    def listen(self, tell: Callable[[JointSample], None]) -> None:
        """See ``Rig.listen``; also reports the joints at each exposure, if they arrive in time."""
        self._tell_joints = tell

    def _stop_nodes(self) -> None:
        for node in self._nodes:
            node.request_stop()
        for node in self._nodes:
            node.stop()

    def close(self) -> None:
        """See ``Rig.close``."""
        self._closing = True
        self._teardown.close()

    def __enter__(self) -> Self:
        """Enter a context that closes the rig."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the rig in any case."""
        self.close()
