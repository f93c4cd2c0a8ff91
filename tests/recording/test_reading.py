"""Recordings of any tool, damaged: what can be read is read, and nothing else happens."""

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from twinct.core.errors import InputError
from twinct.link.recording.reader import RecordedMessage, Recording

PART = np.random.default_rng(1).bytes(300)
"""Of a message; larger than a chunk."""


def written(path, compression):
    """Three messages, each in a chunk of its own, and a file."""
    writer = Writer(str(path), chunk_size=200, compression=compression)
    writer.start("ros2")
    schema = writer.register_schema("sensor_msgs/msg/Image", "ros2msg", b"")
    channel = writer.register_channel("/xray/image", "cdr", schema)
    for i in range(3):
        writer.add_message(channel, i, bytes([i]) + PART, i, i)
    writer.add_attachment(0, 0, "scenario.yaml", "text/yaml", b"name: box")
    writer.finish()
    return path.read_bytes()


def read_from(path):
    """Numbers of the messages, and how many chunks are damaged."""
    recording = Recording(path)
    found = [said.data[0] for said in recording.records() if isinstance(said, RecordedMessage)]
    return found, recording.damaged


@pytest.mark.parametrize("compression", list(CompressionType))
def test_a_damaged_chunk_is_left_out_whatever_packs_it(compression, tmp_path):
    path = tmp_path / "bag.mcap"
    data = bytearray(written(path, compression))
    assert read_from(path) == ([0, 1, 2], 0)
    with path.open("rb") as file:
        chunk = make_reader(file).get_summary().chunk_indexes[1]
    data[chunk.chunk_start_offset + chunk.chunk_length - chunk.compressed_size] ^= 0xFF
    path.write_bytes(data)
    assert read_from(path) == ([0, 2], 1)


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("wrong", [b"\xff" * 8, b"\xff", b"\0"], ids=["large", "byte", "zero"])
def test_wrong_bytes_anywhere_are_refused_or_end_the_reading(compression, wrong, tmp_path):
    path = tmp_path / "bag.mcap"
    data = written(path, compression)
    seen: set[int | str] = set()
    with path.open("r+b") as file:  # to make a file for each costs more than to read it
        for at in range(len(data)):
            file.seek(at)
            file.write(wrong)
            file.flush()
            try:
                seen.add(len(read_from(path)[0]))
            except InputError as error:
                seen.add(str(error))
            file.seek(at)
            file.write(data[at : at + len(wrong)])
            file.truncate(len(data))
    assert path.read_bytes() == data
    assert f"{path} is not an MCAP file" in seen and {2, 3} < seen
