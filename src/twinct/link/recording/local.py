"""Recorder of the local link, which writes the messages that the ROS 2 link would send.

All times are simulated, so that the same scan gives the same file.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twinct.geometry.wire import JointSample, PosePairs, Reached
from twinct.link import plain, topics
from twinct.link.plain import Message
from twinct.link.recording.recorder import Recorder
from twinct.link.stamps import Epoch, Stamp
from twinct.link.topics import Topic
from twinct.scan import LocalRig, Rig, SimulationBuilder
from twinct.scenario import stage_digests

TICK_S = 0.02
"""Longest simulated time between two clock plain."""


class LocalRecorder(Recorder):
    """Recorder of a rig in this process."""

    def __init__(self, folder: Path) -> None:
        """See ``Recorder``."""
        super().__init__(folder)
        self._epoch, self._now_ns = Epoch(Stamp(0, 0)), 0
        self._clock_s: float | None = None

    def begin(self, builder: SimulationBuilder, first: int) -> None:
        """See ``Recorder.begin``."""
        super().begin(builder, first)
        self._now_ns, self._clock_s = 0, None
        self._panel = builder.scenario.detector.panel
        self._epoch = Epoch.of(stage_digests(builder.scenario)["images"])
        at = self._epoch.stamp
        if builder.scenario.cell.kind == "arms":
            self._say(topics.DESCRIPTION, {"data": builder.urdf()})
        if plan := builder.plan:
            self._say(topics.PLAN, plain.trajectory(at, plan))
            self._say(topics.PLAN_VIEWS, plain.plan_views(at, plan))
            self._say(topics.COMMANDED, plain.targets(at, plan.targets))

    def around(self, rig: Rig) -> Rig:
        """See ``Recorder.around``."""
        assert isinstance(rig, LocalRig)
        return _RecordedRig(rig, self)

    def target(self, view: int, target: PosePairs) -> None:
        """Record a target that was sent."""
        self._say(topics.TARGET, plain.targets(self._epoch.at(view), [target]))

    def moving(self, sample: JointSample) -> None:
        """Record the joints during a move."""
        self._advance(sample.time_s)
        stamp = Stamp.at(sample.time_s)
        self._say(topics.JOINTS, plain.joints(stamp, sample))

    def reached(self, view: int, got: Reached) -> Stamp:
        """Record a reached view, and return the stamp of its answers."""
        stamp = Stamp.at(got.middle_s)
        self._advance(got.time_s)
        self._say(topics.VIEWS, plain.view(stamp, self._epoch.at(view), view))
        self._say(topics.REACHED, plain.reached(stamp, got))
        self._say(topics.JOINTS, plain.joints(stamp, got))
        self._say(topics.STATE, plain.state(stamp, got))
        self.write_frames(stamp, got.executed, got.position, self._now_ns)
        return stamp

    def exposed(self, stamp: Stamp, got: Reached, image: NDArray[np.float32]) -> None:
        """Record the image of the view reached last."""
        geometry = got.executed.geometry(self._panel)
        self._say(topics.CAMERA, plain.camera(stamp, geometry))
        self._say(topics.DISPLAY_CAMERA, plain.camera(stamp, geometry, shown=True))
        self._say(topics.DISPLAY, plain.display(stamp, image))
        self._say(topics.IMAGE, plain.image(stamp, image))

    def _advance(self, time_s: float) -> None:
        """Advance the clock to a time, as ``twinct.link.robots_node`` does."""
        start_s = time_s - TICK_S if self._clock_s is None else self._clock_s
        ticks = max(0, math.ceil((time_s - start_s) / TICK_S - 1e-9))
        for tick_s in np.linspace(start_s, time_s, ticks + 1)[1:].tolist():
            tick = Stamp.at(tick_s)
            self._now_ns = tick.ns
            self._say(topics.CLOCK, plain.clock(tick))
        self._clock_s = max(start_s, time_s)

    def _say(self, topic: Topic, message: Message) -> None:
        self.write(topic, message, self._now_ns)


class _RecordedRig(LocalRig):
    """A rig that records each action before it reports the result."""

    def __init__(self, rig: LocalRig, recorder: LocalRecorder) -> None:
        self._rig, self._recorder = rig, recorder
        self.imager = rig.imager
        self._tell: Callable[[JointSample], None] | None = None
        self._last: tuple[Stamp, Reached] | None = None
        self.close = rig.close
        rig.listen(self._moving)

    def move(self, view: int, target: PosePairs) -> Reached:
        """See ``Rig.move``."""
        self._recorder.target(view, target)
        reached = self._rig.move(view, target)
        self._last = self._recorder.reached(view, reached), reached
        return reached

    def expose(self, view: int) -> NDArray[np.float32]:
        """See ``Rig.expose``."""
        image = self._rig.expose(view)
        assert self._last is not None
        self._recorder.exposed(*self._last, image)
        return image

    def listen(self, tell: Callable[[JointSample], None]) -> None:
        """See ``Rig.listen``."""
        self._tell = tell

    def _moving(self, sample: JointSample) -> None:
        self._recorder.moving(sample)
        if self._tell is not None:
            self._tell(sample)
