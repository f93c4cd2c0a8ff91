"""An MCAP file of ROS 2 messages, which stays readable while it grows."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType
from mcap_ros2.writer import Writer

from twinct.link.definitions import definition

MEDIA_TYPES = {
    ".json": "application/json",
    ".npz": "application/octet-stream",
}


class _RawWriter(Writer):
    """Writer that also accepts serialised messages."""

    def add(self, topic: str, kind: str) -> int:
        """Return the channel of a topic; create it on first use."""
        if topic not in self._channel_ids:
            schema = self.register_msgdef(kind, definition(kind))
            self._channel_ids[topic] = self._writer.register_channel(topic, "cdr", schema.id)
        return self._channel_ids[topic]

    def write_raw(self, channel: int, data: bytes, received: int, sent: int, number: int) -> None:
        """Write serialised bytes unchanged."""
        self._writer.add_message(channel, received, data, sent, number)


class Bag:
    """One MCAP file. Callers flush it after each image, so that a killed process loses little."""

    def __init__(self, path: Path, chunk_bytes: int) -> None:
        """Create the file.

        Args:
            path: path of the file, which must not exist.
            chunk_bytes: size above which a chunk is complete; with an image's size, each image
                completes one.

        Raises:
            OSError: the file cannot be written.
        """
        self.path = path
        self._file = path.open("xb")
        # Uncompressed: projections shrink little, and compression would delay the scan.
        self._writer = _RawWriter(self._file, chunk_bytes, CompressionType.NONE)
        self._schemas: dict[str, Any] = {}

    def write(self, topic: str, kind: str, message: Mapping[str, Any], time_ns: int) -> None:
        """Encode a message given as plain data and write it.

        Args:
            topic: topic of the message.
            kind: its type, such as ``geometry_msgs/msg/PoseArray``.
            message: its fields.
            time_ns: time of sending and receipt.
        """
        if kind not in self._schemas:
            self._schemas[kind] = self._writer.register_msgdef(kind, definition(kind))
        self._writer.write_message(topic, self._schemas[kind], message, time_ns)

    def write_raw(
        self, topic: str, kind: str, data: bytes, received_ns: int, sent_ns: int, number: int
    ) -> None:
        """Write a serialised message; ``number`` is its sequence number at its publisher."""
        channel = self._writer.add(topic, kind)
        self._writer.write_raw(channel, data, received_ns, sent_ns, number)

    def attach(self, name: str, data: bytes) -> None:
        """Attach a file to the bag."""
        self._writer.add_attachment(0, 0, name, MEDIA_TYPES[Path(name).suffix], data)
        self.flush()

    def note(self, name: str, values: Mapping[str, str]) -> None:
        """Add text metadata to the bag."""
        self._writer.add_metadata(name, dict(values))
        self.flush()

    def flush(self) -> None:
        """Pass all complete chunks to the operating system."""
        self._file.flush()

    def close(self) -> None:
        """Complete the file; a second call does nothing."""
        if not self._file.closed:
            try:
                self._writer.finish()
            finally:  # on a full disk too
                self._file.close()
