"""Content of a scan's recordings, assembled by view."""

from __future__ import annotations

import re
from collections.abc import Container, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Attachment
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.foreign_text import quoted
from twinct.geometry.wire import Reached
from twinct.link.recording.reader import RecordedMessage, Recording, instants_of
from twinct.link.recording.recorder import FORMAT
from twinct.link.stamps import NANO
from twinct.link.topics import CAMERA, IMAGE, JOINTS, REACHED, STATE, TARGET, VIEWS

SMALL = (TARGET, REACHED, JOINTS, STATE, VIEWS, CAMERA)
"""Topics of a view's data, except its image."""


@dataclass
class Contents:
    """Content of recordings, except the pixels.

    Attributes:
        recordings: source files.
        facts: twinct's metadata of the scan; empty for recordings of other software.
        files: attached files, by name.
        said: messages by topic and stamp.
        imaged: stamps of images, in order.
        topics: all topics that occur.
    """

    recordings: Sequence[Recording]
    facts: dict[str, str] = field(default_factory=dict)
    files: dict[str, bytes] = field(default_factory=dict)
    said: dict[str, dict[int, RecordedMessage]] = field(
        default_factory=lambda: {t: {} for t in SMALL}
    )
    imaged: dict[int, None] = field(default_factory=dict)
    topics: set[str] = field(default_factory=set)

    @classmethod
    def of(cls, paths: Sequence[Path]) -> Contents:
        """Read recordings.

        Raises:
            InputError: there are no recordings, or one is invalid or of a different scan.
        """
        if not paths:
            raise InputError("no recording given; name the MCAP files of a scan")
        contents = cls([Recording(path) for path in paths])
        for recording in contents.recordings:
            for record in recording.records():
                if isinstance(record, RecordedMessage):
                    contents._take(record)
                elif isinstance(record, Attachment):
                    contents.files.setdefault(record.name, record.data)
                elif record.name == "twinct":
                    contents._take_facts(recording.path, record.metadata)
        return contents

    def _take(self, said: RecordedMessage) -> None:
        self.topics.add(said.topic)
        if said.topic == IMAGE:
            self.imaged[said.stamp_ns] = None
        elif said.topic in SMALL:
            self.said[said.topic][said.stamp_ns] = said

    def _take_facts(self, path: Path, facts: dict[str, str]) -> None:
        if facts.get("format") != FORMAT:
            raise InputError(
                f"{path} has recording format {quoted(facts.get('format'))}; this twinct reads "
                f"{FORMAT!r}, and a newer one may read it"
            )
        if "images" not in facts:
            raise InputError(f"{path} does not say which scan it belongs to")
        if self.facts and facts["images"] != self.facts["images"]:
            raise InputError(f"{path} belongs to another scan than {self.recordings[0].path}")
        self.facts = self.facts or facts

    @property
    def names(self) -> str:
        """Paths of the files, as text for users."""
        return ", ".join(str(recording.path) for recording in self.recordings)

    @property
    def problems(self) -> tuple[str, ...]:
        """Damage to the files, as text for users."""
        cut = [f"{r.path} was cut off" for r in self.recordings if not r.whole]
        hurt = [f"{r.path}: {r.damaged} damaged parts" for r in self.recordings if r.damaged]
        return (*cut, *hurt)

    @property
    def view_of(self) -> dict[int, int]:
        """View of each stamp that ``/scan/views`` lists."""
        sources = ((stamp, said.message.source) for stamp, said in self.said[VIEWS].items())
        matches = ((stamp, re.fullmatch("view ([0-9]{1,18})", source)) for stamp, source in sources)
        return {stamp: int(match[1]) for stamp, match in matches if match}

    def at(self, topic: str, stamp: int) -> Any:
        """Return the message of a topic and stamp; None if there is none."""
        said = self.said[topic].get(stamp)
        return None if said is None else said.message

    def reached(self, stamp: int, samples: int) -> Reached | None:
        """Return the state of the robots at a stamp; None if a part is missing.

        Args:
            stamp: stamp, ns.
            samples: the scenario's ``source.motion_samples``.

        Raises:
            InputError: the content of a message does not fit its topic.
        """
        poses, joints, state = (self.at(topic, stamp) for topic in (REACHED, JOINTS, STATE))
        if poses is None or joints is None or state is None:
            return None
        with self.message_of(stamp):
            open_ = samples if samples > 1 else 0
            count = len(poses.poses)
            if count not in (3 + 3 * open_, 6 + 3 * open_):
                raise ValueError(f"{count} poses on {REACHED}")
            instants = instants_of(poses.poses)
            numbers = np.array(state.data)
            reached = Reached(
                executed=instants[:1],
                joint_names=tuple(joints.name),
                position=np.array(joints.position),
                velocity=np.array(joints.velocity),
                effort=np.array(joints.effort),
                state=numbers[state.layout.data_offset :],
                time_s=float(numbers[0]),
                clearance_mm=float(numbers[1]),
                exposure=instants[1 : 1 + open_],
                before=instants[1 + open_ :] or None,
            )
            return checked(reached)

    @contextmanager
    def message_of(self, stamp: int) -> Generator[None]:
        """Turn any error in reading a stamp's messages into one message.

        Raises:
            InputError: a message is invalid; the text names recordings and stamp.
        """
        try:
            yield
        except (ValueError, LookupError, TypeError, ArithmeticError) as error:
            sec, nanosec = divmod(stamp, NANO)
            at = f"stamp {sec}.{nanosec:09d}"
            raise InputError(f"{self.names}: messages of {at}: {error}") from None

    def images(self, stamps: Container[int]) -> Iterator[tuple[int, NDArray[np.float32]]]:
        """Yield the images of these stamps, (rows, columns), each once.

        Raises:
            InputError: an image is invalid.
        """
        given: set[int] = set()
        for recording in self.recordings:
            for record in recording.records():
                if isinstance(record, RecordedMessage) and record.topic == IMAGE:
                    if (stamp := record.stamp_ns) in stamps and stamp not in given:
                        given.add(stamp)
                        yield stamp, _pixels(record.message)


def checked(reached: Reached) -> Reached:
    """Check finite numbers, and one number of each kind per joint; return the input.

    Raises:
        ValueError: a check fails.
    """
    joints, state = len(reached.joint_names), reached.state
    for name in ("position", "velocity", "effort"):
        numbers = getattr(reached, name)
        if len(numbers) != joints or not np.isfinite(numbers).all():
            raise ValueError(f"{name} on {JOINTS}: not a finite number for each of {joints} joints")
    if not np.isfinite([*state, reached.time_s]).all() or np.isinf(reached.clearance_mm):
        raise ValueError(f"{STATE} holds a number that is not finite")
    return reached


def _pixels(message: Any) -> NDArray[np.float32]:
    rows, columns = message.height, message.width
    if message.encoding != "32FC1" or len(message.data) != 4 * rows * columns:
        raise InputError(
            f"{IMAGE}: {columns} x {rows} px, {message.encoding}, {len(message.data)} bytes: "
            "only 32-bit floats (32FC1) without padding are read"
        )
    pixels = np.frombuffer(message.data, ">f4" if message.is_bigendian else "<f4")
    if not np.isfinite(pixels).all():
        raise InputError(f"{IMAGE}: a pixel is not finite")
    return pixels.reshape(rows, columns).astype(np.float32)
