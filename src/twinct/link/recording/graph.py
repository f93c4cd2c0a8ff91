"""Recorder of the ROS 2 link, which writes the received bytes unchanged."""

from __future__ import annotations

import logging
from itertools import chain
from pathlib import Path
from threading import Condition
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twinct.link.recording.reader import RecordedMessage, instants_of, reader_of
from twinct.link.recording.recorder import Recorder
from twinct.link.stamps import NANO, Stamp
from twinct.link.topics import (
    CAMERA,
    DISPLAY,
    DISPLAY_CAMERA,
    IMAGE,
    JOINTS,
    REACHED,
    STATE,
    VIEWS,
)
from twinct.scan import Rig, SimulationBuilder

if TYPE_CHECKING:
    from twinct.link.tap import Heard

log = logging.getLogger(__name__)

PARTS = (VIEWS, REACHED, JOINTS, STATE, CAMERA, DISPLAY_CAMERA, DISPLAY)
"""Topics of a view that are written before its image, so that no image lacks them."""

PATIENCE_S = 300.0
"""Longest wait of a scan for the recorder to receive an image.

Milliseconds are enough, except on a busy machine.
"""


class GraphRecorder(Recorder):
    """Recorder of all messages of a scan's processes, called in the thread of the listener."""

    def __init__(self, folder: Path) -> None:
        """See ``Recorder``."""
        super().__init__(folder)
        self.hear = self._hear
        self._changed = Condition()
        self._imaged: set[int] = set()
        self._images: dict[int, list[Heard]] = {}
        self._parts: dict[tuple[str, int], Heard] = {}
        self._numbers: dict[tuple[str, str], int] = {}
        self._lost: dict[str, int] = {}
        self._broken = False

    def begin(self, builder: SimulationBuilder, first: int) -> None:
        """See ``Recorder.begin``."""
        super().begin(builder, first)
        self._imaged.clear()
        self._broken = False

    def _hear(self, heard: Heard) -> None:
        """Write a message; errors end the recording, not the scan."""
        if self._broken:
            return
        try:
            self._count(heard)
            self._keep(heard)
        except Exception as error:
            log.exception("the recording ends here")
            self.problems.append(f"{self.path} ends early: {error}")
            self._broken = True
            with self._changed:
                self._changed.notify_all()

    def _count(self, heard: Heard) -> None:
        """Count messages that were lost in transit, from their publishers' sequence numbers."""
        publisher = heard.topic, heard.publisher
        lost = heard.number - self._numbers.get(publisher, 0) - 1
        self._numbers[publisher] = heard.number
        if lost > 0:
            self._lost[heard.topic] = self._lost.get(heard.topic, 0) + lost

    def _keep(self, heard: Heard) -> None:
        """Write a message; hold an image back until its view's other messages are written."""
        stamp = RecordedMessage(heard.topic, heard.kind, heard.raw.data).stamp_ns
        if heard.topic == IMAGE and stamp not in self._imaged:
            self._images.setdefault(stamp, []).append(heard)  # several if a target was repeated
        else:
            self._write(heard)
            self._parts[heard.topic, stamp] = heard
        if stamp in self._images and all((part, stamp) in self._parts for part in PARTS):
            self._finish_view(stamp)

    def _finish_view(self, stamp: int) -> None:
        images = self._images.pop(stamp)
        reached, joints = (
            reader_of(part.kind)(part.raw.data)
            for part in (self._parts[REACHED, stamp], self._parts[JOINTS, stamp])
        )
        where = instants_of(reached.poses[:3])
        self.write_frames(
            Stamp(*divmod(stamp, NANO)), where, joints.position, images[0].raw.received_ns
        )
        for image in images:
            self._write(image)
        self._parts.clear()
        with self._changed:
            self._imaged.add(stamp)
            self._changed.notify_all()

    def _write(self, heard: Heard) -> None:
        assert self._bag is not None
        data, sent, received = heard.raw
        self._bag.write_raw(heard.topic, heard.kind, data, received, sent, heard.number)
        if heard.topic == IMAGE:
            self._bag.flush()

    def has_images(self, count: int) -> bool:
        """Wait until ``count`` images are in the file; return False on timeout."""
        with self._changed:
            return self._changed.wait_for(
                lambda: self._broken or len(self._imaged) >= count, PATIENCE_S
            )

    def around(self, rig: Rig) -> Rig:
        """See ``Recorder.around``."""
        return _Waiting(rig, self)

    def close(self) -> None:
        """See ``Recorder.close``."""
        for heard in chain.from_iterable(self._images.values()):
            self._write(heard)
        self._images.clear()
        for topic, count in self._lost.items():
            self.problems.append(f"{self.path} lacks {count} messages of {topic}")
        self._lost.clear()
        super().close()


class _Waiting:
    """A rig that returns each image only after it is recorded."""

    def __init__(self, rig: Rig, recorder: GraphRecorder) -> None:
        self._rig, self._recorder = rig, recorder
        self._expected = 0
        self.move, self.listen, self.close = rig.move, rig.listen, rig.close

    def expose(self, view: int) -> NDArray[np.float32]:
        """See ``Rig.expose``."""
        image = self._rig.expose(view)
        self._expected += 1
        if not self._recorder.has_images(self._expected):
            self._expected -= 1
            self._recorder.problems.append(f"{self._recorder.path} lacks the image of view {view}")
        return image
