"""The rig over ROS 2: two node processes, and this one that asks them view by view."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Self

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray
from numpy.typing import NDArray
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import Float64MultiArray

from twinct.errors import LinkError, TargetRefusedError
from twinct.ros.environment import (
    Domain,
    require_ros,
    settle,
    sweep_shared_memory,
    without_system_ros,
)
from twinct.ros.messages import (
    ERROR,
    OK,
    Epoch,
    Executed,
    Stamp,
    diagnostic_values,
    executed_of,
    image_of,
    reached_of,
    state_stamp,
    target_message,
)
from twinct.ros.node import LISTENERS
from twinct.ros.processes import NodeProcess
from twinct.ros.robots_node import NAME as ROBOTS
from twinct.ros.robots_node import describe
from twinct.ros.station import DIAGNOSTICS, IMAGE, JOINTS, REACHED, STATE, TARGET, Station
from twinct.ros.xray_node import NAME as XRAY
from twinct.scenario import Scenario
from twinct.views import Reached, Target

NODE_COMMAND = (sys.executable, "-m", "twinct.ros")
START_S = 900.0
"""Time for both nodes to build their simulations."""
ANSWER_S = 600.0
"""Time for one answer. A node that dies is noticed at once; this is for one that hangs."""
FIRST_REPEAT_S, LONGEST_REPEAT_S = 2.0, 60.0
"""A target is sent again after this silence, then after twice as long, and so on."""


class _View:
    """What has come in for one view."""

    def __init__(self) -> None:
        self.poses: Executed | None = None
        self.joints: JointState | None = None
        self.state: Float64MultiArray | None = None
        self.image: Image | None = None


class RosRig:
    """A ``Rig`` whose two simulations are ROS 2 nodes in processes of their own.

    Attributes:
        domain_id: the ROS domain of this scan, and of no other on this machine.
        epoch: what its stamps count from.
        log_dir: folder with ``robots.log`` and ``xray.log``.
    """

    def __init__(
        self,
        scenario: Scenario,
        *,
        first_view: int = 0,
        start_state: NDArray[np.float64] | None = None,
        log_dir: Path | None = None,
        domain: Domain | None = None,
        node_command: Sequence[str] = NODE_COMMAND,
        answer_s: float = ANSWER_S,
    ) -> None:
        """Start both nodes and wait until they are at work.

        Args:
            scenario: what to simulate.
            first_view: first view that will be asked for.
            start_state: simulator state to start from; None for the planned home.
            log_dir: folder for what the nodes print; None for a temporary one.
            domain: held for this scan, and closed with the rig; None takes ``ROS_DOMAIN_ID``, and
                where that is not set a free domain.
            node_command: starts a node when ``robots`` or ``xray`` and the options are appended.
            answer_s: how long one answer may take.

        Raises:
            MissingExtraError: rclpy is not installed.
            InputError: the domain asked for is in use, or is none.
            LinkError: a node did not start.
        """
        require_ros()
        settle(os.environ)
        self.epoch = Epoch.of(scenario)
        self._answer_s = answer_s
        self._samples = scenario.source.motion_samples
        self._views: dict[Stamp, _View] = {}
        self._asked: tuple[int, Stamp, PoseArray] | None = None
        self._ready: set[str] = set()
        self._refusal: str | None = None
        self._conflict: str | None = None
        self._nodes: list[NodeProcess] = []
        self._ended: list[NodeProcess] = []
        self._station: Station | None = None
        self._closing = False
        self._teardown = ExitStack()
        with ExitStack() as stack:
            domain = domain or Domain()
            stack.callback(domain.close)
            sweep_shared_memory()
            stack.callback(sweep_shared_memory)
            self.domain_id = domain.id
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="twinct-")))
            self.log_dir = folder if log_dir is None else log_dir
            self.log_dir.mkdir(parents=True, exist_ok=True)
            stack.callback(self._stop_nodes)
            self._start_nodes(scenario, folder, domain, first_view, start_state, node_command)
            station = self._station = Station("twinct_scan", self.domain_id)
            stack.callback(station.close)
            self._open(station)
            for name in ("scenario.json", "start.npy"):  # read; must not outlive a killed parent
                (folder / name).unlink(missing_ok=True)
            self._teardown = stack.pop_all()

    def _start_nodes(
        self,
        scenario: Scenario,
        folder: Path,
        domain: Domain,
        first_view: int,
        start_state: NDArray[np.float64] | None,
        command: Sequence[str],
    ) -> None:
        file = folder / "scenario.json"
        file.write_text(scenario.resolved(), encoding="utf-8")
        common = [str(file), "--epoch", str(self.epoch), "--lifeline"]
        start = ["--first-view", str(first_view)]
        if start_state is not None:
            np.save(folder / "start.npy", start_state)
            start += ["--restore", str(folder / "start.npy")]
        environment = {**without_system_ros(os.environ), "ROS_DOMAIN_ID": str(domain.id)}
        for name, options in (("robots", start), ("xray", [])):
            process = NodeProcess(
                name,
                [*command, name, *common, *options],
                self.log_dir / f"{name}.log",
                environment=environment,
                inherit=[domain.hold],
                on_end=self._on_node_end,
            )
            self._nodes.append(process)

    def _on_node_end(self, ended: NodeProcess) -> None:
        """Without one node the other has no purpose; this process hears of it in its next wait."""
        self._ended.append(ended)
        for node in self._nodes:
            if node is not ended:
                node.request_stop()
        if self._station is not None:
            self._station.wake()

    def _open(self, station: Station) -> None:
        self._target = station.publisher(TARGET, PoseArray)
        heard = [
            station.listen(REACHED, PoseArray, self._on_reached),
            station.listen(JOINTS, JointState, self._on_joints),
            station.listen(STATE, Float64MultiArray, self._on_state),
            station.listen(IMAGE, Image, self._on_image),
        ]
        station.listen(DIAGNOSTICS, DiagnosticArray, self._on_diagnostics)

        def connected() -> bool:
            return (
                self._ready >= {ROBOTS, XRAY}
                and self._target.get_subscription_count() >= LISTENERS
                and all(subscription.get_publisher_count() for subscription in heard)
            )

        if not station.wait(lambda: self._broken() or connected(), START_S):
            raise LinkError(f"the nodes were not at work {START_S:.0f} s after their start")
        self._check()
        for topic, owner in ((REACHED, ROBOTS), (IMAGE, XRAY)):
            publishers = station.publishers(topic)
            if len(publishers) > 1:
                others = sorted(publishers)
                raise LinkError(
                    f"{topic} on ROS domain {self.domain_id} has {len(publishers)} publishers "
                    f"({', '.join(others)}), expected only {owner} of this scan: "
                    "end the others, or choose another domain"
                )

    def _view(self, stamp: Stamp) -> _View | None:
        """Where to put what comes in for a stamp; None for a stranger's."""
        if self.epoch.view(stamp) is None:
            return None
        return self._views.setdefault(stamp, _View())

    def _on_reached(self, message: PoseArray) -> None:
        view = self._view(stamp := Stamp.of(message.header.stamp))
        if view is None:
            return
        try:
            poses = executed_of(message)
        except ValueError as error:
            self._conflict = f"{REACHED} at {stamp}: {error}"
            return
        if view.poses not in (None, poses):
            self._conflict = f"{REACHED} has two answers at {stamp}: a stranger speaks there"
        view.poses = poses

    def _on_joints(self, message: JointState) -> None:
        if (view := self._view(Stamp.of(message.header.stamp))) is not None:
            view.joints = message

    def _on_state(self, message: Float64MultiArray) -> None:
        stamp = state_stamp(message)
        if stamp is not None and (view := self._view(stamp)) is not None:
            view.state = message

    def _on_image(self, message: Image) -> None:
        if (view := self._view(Stamp.of(message.header.stamp))) is not None:
            view.image = message

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self._ready |= {status.name for status in message.status if status.level == OK}
        stamp = Stamp.of(message.header.stamp)
        if self._asked is None or stamp != self._asked[1]:
            return
        for status in message.status:
            if status.level != ERROR:
                continue
            values = diagnostic_values(status.values)
            if status.name == ROBOTS and values.get("target") == describe(self._asked[2]):
                arm = f" ({values['arm']} arm)" if values.get("arm") else ""
                self._refusal = f"{values.get('reason', status.message)}{arm}"
            elif status.name == XRAY:
                self._conflict = status.message

    def _broken(self) -> bool:
        return self._conflict is not None or bool(self._ended)

    def _check(self) -> None:
        if self._ended:  # the first took the other with it
            raise LinkError(self._ended[0].describe_end())
        if self._conflict is not None:
            raise LinkError(self._conflict)

    def _wait(self, what: str, done: Callable[[], bool]) -> None:
        """Wait for an answer to the target last asked, and ask again when none comes."""
        if self._station is None or self._closing or self._asked is None:
            raise LinkError("the rig is closed")
        view, _, message = self._asked
        deadline = time.monotonic() + self._answer_s
        silence = FIRST_REPEAT_S
        while True:
            left = deadline - time.monotonic()
            if self._station.wait(lambda: self._broken() or done(), min(silence, max(left, 0.0))):
                break
            if time.monotonic() >= deadline:
                raise LinkError(f"no {what} of view {view} within {self._answer_s:.0f} s")
            silence = min(2 * silence, LONGEST_REPEAT_S)
            self._target.publish(message)
        self._check()

    def move(self, view: int, target: Target) -> Reached:
        """See ``Rig.move``."""
        if self._closing:
            raise LinkError("the rig is closed")
        stamp = self.epoch.at(view)
        for old in [s for s in self._views if s != stamp]:
            del self._views[old]
        got = self._views.setdefault(stamp, _View())
        self._refusal = None
        self._asked = view, stamp, target_message(stamp, target)
        self._target.publish(self._asked[2])

        def done() -> bool:
            return self._refusal is not None or None not in (got.poses, got.joints, got.state)

        self._wait("reached poses", done)
        if self._refusal is not None:
            raise TargetRefusedError(f"view {view}: {self._refusal}")
        assert got.poses is not None and got.joints is not None and got.state is not None
        return reached_of(got.poses, got.joints, got.state, self._samples)

    def expose(self, view: int) -> NDArray[np.float32]:
        """See ``Rig.expose``."""
        if self._asked is None or self._asked[0] != view or self._refusal is not None:
            raise ValueError(f"view {view} was not reached: move before you expose")
        got = self._views[self._asked[1]]
        self._wait("image", lambda: got.image is not None)
        assert got.image is not None
        return image_of(got.image)

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
        """Use as a context."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close, whatever happened."""
        self.close()
