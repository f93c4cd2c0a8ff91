"""Reader of recordings from any software, even if they were cut off."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Chunk, Footer, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap_ros2.decoder import DecoderFactory
from zstandard import ZstdError

from twinct.core.errors import InputError
from twinct.core.files.boundary import no_file
from twinct.core.files.packed import require_growth, require_unpacked
from twinct.core.files.streams import stream_bytes
from twinct.core.foreign_text import whole_number
from twinct.geometry.wire import PosePairs
from twinct.link.definitions import definition
from twinct.link.stamps import NANO
from twinct.link.topics import STATE

Decode = Callable[[bytes], Any]

_BROKEN = (
    *(McapError, ValueError, LookupError, struct.error, MemoryError),
    OverflowError,  # a length beyond any address
    *(ZstdError, RuntimeError),  # errors of chunk decompression; RuntimeError comes from lz4
)
"""Errors of reading; after a cut or a wrong byte, any of them may occur."""

LARGEST_RECORD = 2**31
"""Size limit, bytes; an image of 20,000 x 20,000 pixels is smaller."""


_CODECS = {"zstd": "zstd", "lz4": "lz4 frame"}
"""Codecs of chunks, by their names in MCAP."""

_MAGIC_BYTES = 8
_RECORD = struct.Struct("<BQ")
"""Opcode and length of a record."""

_CHUNK = struct.Struct("<QQQII")
"""Beginning of a chunk: its first and last time, its size, checksum and the length of a text."""


def _packed_chunks(file: BinaryIO) -> tuple[int, int]:
    """Return the bytes of all packed chunks in a file, and those that they state to unpack to."""
    packed, unpacked = 0, 0
    file.seek(_MAGIC_BYTES)
    while len(head := file.read(_RECORD.size)) == _RECORD.size:
        opcode, length = _RECORD.unpack(head)
        if length > LARGEST_RECORD:
            break  # damage, where the reader stops as well
        start = file.tell()
        if opcode == Opcode.CHUNK and len(begin := file.read(_CHUNK.size)) == _CHUNK.size:
            _, _, size, _, text = _CHUNK.unpack(begin)
            if text:
                packed, unpacked = packed + length, unpacked + size
        file.seek(start + length)
    return packed, unpacked


class RecordedMessage(NamedTuple):
    """A message of a recording, whose fields are read on request.

    Attributes:
        topic: its topic.
        kind: its type, such as ``sensor_msgs/msg/Image``.
        data: the serialised message.
    """

    topic: str
    kind: str
    data: bytes

    @property
    def message(self) -> Any:
        """Deserialised message, with its fields as attributes.

        Raises:
            InputError: the data do not fit the type.
        """
        try:
            return reader_of(self.kind)(self.data)
        except _BROKEN as error:
            raise InputError(f"a message on {self.topic} is not a {self.kind}: {error}") from None

    @property
    def stamp_ns(self) -> int:
        """``header.stamp``, or the label of ``/scan/state``, without reading the rest; -1 if none.

        In CDR, four bytes precede the message, and texts begin with their length.
        """
        order = "<" if self.data[1:2] == b"\1" else ">"
        try:
            if self.topic != STATE:
                sec, nanosec = struct.unpack_from(f"{order}iI", self.data, 4)
            else:
                (length,) = struct.unpack_from(f"{order}I", self.data, 8)
                parts = self.data[12 : 11 + length].decode("ascii").split(".")
                sec, nanosec = (whole_number(part) for part in parts)
        except (struct.error, ValueError):
            return -1
        if sec is None or nanosec is None:
            return -1
        return sec * NANO + nanosec


@cache
def reader_of(kind: str) -> Decode:
    """Return the function that deserialises a message."""
    text = definition(kind).encode()
    decode = DecoderFactory().decoder_for("cdr", Schema(1, text, "ros2msg", kind))
    assert decode is not None
    return decode


_IMAGES = (".tif", ".tiff", ".png", ".raw", ".img", ".npy", ".npz", ".h5", ".hdf5", ".mha", ".dcm")
"""Endings of images, which somebody may give in place of their description."""

_OF_IMAGES = (
    ", but images without geometry: state images and geometry in a YAML file (docs/measured.md)"
)


class Recording:
    """A file, read from its beginning each time.

    Attributes:
        path: path of the file.
        whole: True if the file ends properly; known only after reading all records.
        damaged: number of chunks skipped because of a wrong checksum.
    """

    def __init__(self, path: Path) -> None:
        """Check that the file is a recording.

        Raises:
            InputError: the file is no recording, cannot be read, or unpacks to too much.
        """
        self.path = path
        self.whole, self.damaged = False, 0
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        if why := no_file(path):
            raise InputError(f"{path} {why}")
        try:
            with path.open("rb") as file:
                next(StreamReader(file).records, None)
                packed, unpacked = _packed_chunks(file)
                require_growth(packed, unpacked, f"{path}")
                file.seek(0)
                self._read_summary(file)
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror}") from None
        except _BROKEN:
            hint = _OF_IMAGES if path.suffix.lower() in _IMAGES else ""
            raise InputError(f"{path} is not an MCAP file{hint}") from None

    def _read_summary(self, file: BinaryIO) -> None:
        """Read the channels repeated at the end, in case the chunk that defines them is damaged."""
        with suppress(*_BROKEN, OSError):
            if (summary := SeekingReader(file).get_summary()) is not None:
                self._schemas, self._channels = summary.schemas, summary.channels

    def records(self) -> Iterator[RecordedMessage | Attachment | Metadata]:
        """Yield messages in ROS 2's encoding, attachments and metadata, in the order of writing.

        A file that was cut off yields its remaining records.
        """
        schemas, channels = dict(self._schemas), dict(self._channels)
        self.whole, self.damaged = False, 0
        with self.path.open("rb") as file:
            stream = StreamReader(file, emit_chunks=True, record_size_limit=LARGEST_RECORD).records
            while (record := self._next(stream)) is not None:
                for part in self._parts(record):
                    if isinstance(part, Schema):
                        schemas[part.id] = part
                    elif isinstance(part, Channel):
                        channels[part.id] = part
                    elif isinstance(part, Message):
                        channel = channels.get(part.channel_id)
                        schema = channel and schemas.get(channel.schema_id)
                        if channel and schema and channel.message_encoding == "cdr":
                            yield RecordedMessage(channel.topic, schema.name, part.data)
                    elif isinstance(part, Attachment | Metadata):
                        yield part

    def _next(self, stream: Iterator[Any]) -> Any:
        try:
            record = next(stream, None)
        except _BROKEN:
            return None
        self.whole |= isinstance(record, Footer)
        return record

    def _parts(self, record: Any) -> Sequence[Any]:
        if not isinstance(record, Chunk):
            return (record,)
        try:
            if (codec := _CODECS.get(record.compression)) is not None:
                stated = record.uncompressed_size
                require_unpacked(len(record.data), stated, f"{self.path}: a chunk", copies=2)
                # A frame that states another size is damaged, and libraries make room for it.
                if stream_bytes(record.data, codec, stated) != stated:
                    raise ValueError("a chunk of another size than stated")
            return breakup_chunk(record, validate_crc=True)
        except _BROKEN:
            self.damaged += 1
            return ()


def seven_of(pose: Any) -> tuple[float, ...]:
    """Return position, m, and quaternion (x, y, z, w) of a ``geometry_msgs/msg/Pose``."""
    p, q = pose.position, pose.orientation
    return p.x, p.y, p.z, q.x, q.y, q.z, q.w


def instants_of(poses: Sequence[Any]) -> PosePairs:
    """Return the instants of poses of source, object and detector."""
    numbers = list(map(seven_of, poses))
    return PosePairs.from_sevens(numbers[i : i + 3] for i in range(0, len(numbers), 3))
