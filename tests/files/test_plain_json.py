"""JSON of files: whatever it is, a value or a message; nothing is waited for."""

import os

import pytest

from twinct.core.files import plain_json
from twinct.core.files.plain_json import json_of, read_json


@pytest.mark.parametrize("text", ["[" * 100_000, "1" * 5000, b"\xff", "{"])
def test_what_is_no_json_is_told_so(text):
    with pytest.raises(ValueError):
        json_of(text)


def test_a_file_is_no_larger_than_the_limit(tmp_path, monkeypatch):
    monkeypatch.setattr(plain_json, "LARGEST_BYTES", 5)
    (tmp_path / "large").write_text("[1, 2]")
    with pytest.raises(ValueError, match="large has 6 bytes; the limit is 5"):
        read_json(tmp_path / "large")


def test_only_a_file_is_read(tmp_path):
    (tmp_path / "good").write_text('{"a": [1]}')
    assert read_json(tmp_path / "good") == {"a": [1]}
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ValueError, match="pipe is a named pipe"):
        read_json(tmp_path / "pipe")
