"""The X-ray simulation as a ROS 2 node: ``/scan/reached`` in, ``/xray/image`` out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from geometry_msgs.msg import PoseArray
from numpy.typing import NDArray
from sensor_msgs.msg import TimeReference

from twinct.core.errors import TwinctError
from twinct.geometry import Panel
from twinct.geometry.wire import PosePairs
from twinct.link import messages
from twinct.link.joint_trajectory import PlanListener
from twinct.link.messages import MalformedError
from twinct.link.node import Diagnostics, Ledger, RefusedError, run_node
from twinct.link.participant import Station
from twinct.link.senders import Members, Sender
from twinct.link.stamps import Epoch, Stamp
from twinct.link.topics import (
    CAMERA,
    DISPLAY,
    DISPLAY_CAMERA,
    IMAGE,
    REACHED,
    ROBOTS,
    VIEWS,
    XRAY,
    Topic,
)
from twinct.scan import SimulationBuilder
from twinct.scenario import Scenario
from twinct.version import __version__

if TYPE_CHECKING:
    from twinct.robots.motion import MotionPlan
    from twinct.scan import SimulationBuilder

ANSWER = (CAMERA, IMAGE, DISPLAY_CAMERA, DISPLAY)
"""Topics of a view's messages."""

MEMORY_BYTES = 256 * 2**20
"""Memory for images stored for repeated requests; at least two images, at most 32."""

QUEUE_BYTES = 64 * 2**20
"""Memory for images queued for slow or late subscribers; at least one image."""


class XRay(Protocol):
    """Protocol of an ``Imager``, as far as the node needs it."""

    def expose(
        self,
        path: PosePairs,
        view: int = 0,
        before: PosePairs | None = None,
        *,
        time_s: float = 0.0,
    ) -> NDArray[np.float32]:
        """Return the transmission of one view."""
        ...

    def close(self) -> None:
        """Release all resources."""


def spin_xray(
    scenario: Scenario,
    *,
    epoch: str | None = None,
    specimen: Path | None = None,
    members: Members | None = None,
    lifeline: bool = False,
    build: Callable[[Panel], XRay] | None = None,
) -> int:
    """Run the X-ray simulation as a node until SIGINT or SIGTERM.

    Args:
        scenario: scenario to simulate.
        epoch: epoch of the node's scan, whose views alone are imaged. None images any view.
        specimen: file of the built specimen; None builds it.
        members: members of that scan; only poses from its robots node are imaged.
        lifeline: also end when stdin ends.
        build: builds a simulation in place of the real one.

    Returns:
        Exit code: 0.
    """
    panel, samples = scenario.detector.panel, scenario.source.motion_samples
    own = Epoch.parse(epoch) if epoch is not None else None

    def build_simulation() -> XRay:
        if build is not None:
            return build(panel)
        builder = SimulationBuilder.with_specimen(scenario, specimen)
        if members is not None and builder.plan_chooses:
            return _AsPlanned(builder)
        return builder.imager()

    def open_node(station: Station, diagnostics: Diagnostics, imager: XRay) -> Callable[[], bool]:
        node = XRayNode(station, diagnostics, imager, panel, own, members, samples)
        if members is None or not isinstance(imager, _AsPlanned):
            return node.connected
        plan = PlanListener(station, diagnostics, members, imager.follow)
        return lambda: plan.taken and node.connected()

    return run_node(
        XRAY,
        build_simulation,
        open_node,
        lifeline=lifeline,
        members=members,
        largest_message=image_bytes(panel),
        parameters={"scenario": scenario.resolved(), "version": __version__},
    )


class _AsPlanned:
    """Imager of a scan whose views are known only from its plan."""

    def __init__(self, builder: SimulationBuilder) -> None:
        self._builder = builder
        self._imager: XRay | None = None

    def follow(self, plan: MotionPlan) -> None:
        """Take the commanded geometry from a plan."""
        self._imager = replace(self._builder, given_plan=plan).imager()

    def expose(
        self,
        path: PosePairs,
        view: int = 0,
        before: PosePairs | None = None,
        *,
        time_s: float = 0.0,
    ) -> NDArray[np.float32]:
        if self._imager is None:
            raise RefusedError("the plan of the scan has not arrived")
        return self._imager.expose(path, view, before, time_s=time_s)

    def close(self) -> None:
        if self._imager is not None:
            self._imager.close()


def image_bytes(panel: Panel) -> int:
    """Return the size of an image, bytes."""
    return 4 * panel.rows * panel.columns


def answer_bytes(panel: Panel) -> int:
    """Return the size of an image and its display version, bytes."""
    return image_bytes(panel) + panel.rows * panel.columns


class _Taken(NamedTuple):
    """Key of an image: its stamp, and the clock that the stamp belongs to."""

    stamp: Stamp
    clock: str

    def __str__(self) -> str:
        return str(self.stamp)


class XRayNode:
    """Node that images each reached view once."""

    def __init__(
        self,
        station: Station,
        diagnostics: Diagnostics,
        imager: XRay,
        panel: Panel,
        epoch: Epoch | None = None,
        members: Members | None = None,
        samples: int = 1,
    ) -> None:
        """Create the endpoints; from now on, views are imaged."""
        self._imager, self._panel, self._samples = imager, panel, samples
        self._epoch, self._members, self._diagnostics = epoch, members, diagnostics
        self._ledger: Ledger[_Taken, PosePairs, list[Any]] = Ledger(
            keep=min(max(MEMORY_BYTES // answer_bytes(panel), 2), 32)
        )
        # For a scan: targets by time of arrival, and poses whose target is still unknown.
        self._targets: dict[Stamp, Stamp] = {}
        self._early: dict[Stamp, tuple[PoseArray, Sender]] = {}
        depth = min(max(QUEUE_BYTES // image_bytes(panel), 1), IMAGE.depth)
        self._peers = 0
        self._out = [station.publisher(topic, depth=depth) for topic in ANSWER]
        self._heard = [
            *station.listen_to_all(REACHED, self._on_reached),
            *([station.listen(VIEWS, self._on_view)] if epoch else []),
        ]

    def connected(self) -> bool:
        """Return True if the scan's rig and robots node are connected, or there is no scan."""
        self._watch()
        if self._members is not None and not self._members.knows(ROBOTS):
            return False
        return self._epoch is None or (
            all(heard.get_publisher_count() for heard in self._heard)
            and bool(self._out[ANSWER.index(IMAGE)].get_subscription_count())
        )

    def _watch(self) -> None:
        """Tell, outside a scan, that the last robots node is gone.

        One that was killed counts until its lease expires.
        """
        count = max((heard.get_publisher_count() for heard in self._heard), default=0)
        if self._epoch is None and count == 0 < self._peers:
            self._diagnostics.warn(
                f"no node publishes {REACHED} any more: the robots node ended, was killed or was "
                "cut off; waiting for another one"
            )
        self._peers = count

    def _known(self, topic: Topic, sender: Sender) -> bool:
        if self._members is None or self._members.has(ROBOTS, sender.participant):
            return True
        self._diagnostics.stranger(topic, self._members)
        return False

    def _on_view(self, message: TimeReference, sender: Sender) -> None:
        if not self._known(VIEWS, sender):
            return
        stamp = Stamp.of(message.header.stamp)
        self._targets[stamp] = Stamp.of(message.time_ref)
        if early := self._early.pop(stamp, None):
            self._on_reached(*early)

    def _on_reached(self, message: PoseArray, sender: Sender) -> None:
        if not self._known(REACHED, sender):
            return
        stamp, view = Stamp.of(message.header.stamp), None
        target = stamp
        if self._epoch is not None:
            if stamp not in self._targets:
                self._early[stamp] = message, sender
                return
            target = self._targets[stamp]
            view = self._epoch.view(target)
        try:
            poses, taken = messages.executed_of(message), _Taken(stamp, sender.participant)
            answer = self._ledger.find(taken, poses) or self._expose(taken, view, poses)
        except (RefusedError, MalformedError) as refused:
            values: dict[str, object] = {"view": "" if view is None else view, "reason": refused}
            self._diagnostics.refuse(target, f"view refused: {refused}", values)
            return
        for out, answered in zip(self._out, answer, strict=True):
            out.publish(answered)

    def _expose(self, taken: _Taken, view: int | None, poses: PosePairs) -> list[Any]:
        if self._epoch is not None and view is None:
            raise RefusedError("a scan is running, and this view does not belong to it")
        stamp = taken.stamp
        try:
            exposure, before = messages.parts_of(poses, self._samples)
            geometry = poses.geometry(self._panel)[0]
        except ValueError as error:
            raise MalformedError(str(error)) from None
        # Key of the noise: the view or, without a scan, the time itself.
        index = stamp.sec * 1_000_000_000 + stamp.nanosec if view is None else view
        if index < 0:
            raise MalformedError(f"header.stamp {stamp} is negative")
        try:
            image = self._imager.expose(exposure or poses[:1], index, before, time_s=stamp.time_s)
        except TwinctError as error:  # such as a source inside the specimen
            raise RefusedError(str(error)) from None
        answer = [
            messages.camera_message(stamp, geometry),
            messages.image_message(stamp, image),
            messages.camera_message(stamp, geometry, display=True),
            messages.display_message(stamp, image),
        ]
        self._ledger.enter(taken, poses, answer)
        name = stamp if view is None else f"view {view}"
        self._diagnostics.tell(f"image of {name}: mean {image.mean():.4f}")
        return answer
