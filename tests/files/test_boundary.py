"""What comes in as a file: regular ones alone, bounded, and whatever a library throws is said."""

from __future__ import annotations

import os
import resource
from pathlib import Path

import pytest

from twinct.core.errors import InputError, SpecimenError, TrajectoryError
from twinct.core.files.boundary import (
    absolute,
    library_errors,
    no_file,
    read_bytes,
    read_text,
    require_memory,
)


def test_what_is_no_regular_file_is_not_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "zero").symlink_to("/dev/zero")
    (tmp_path / "loop").symlink_to("loop")
    for name, why in {
        "pipe": r"is a named pipe \(FIFO\), not a file",
        "zero": "is a device, not a file",
        "none": "does not exist",
        **{".": "is a folder, not a file", "loop": "cannot be read", "x" * 300: "cannot be read"},
        "a\0b": "cannot be read",
    }.items():
        with pytest.raises(SpecimenError, match=f"^the mesh {why}"):
            read_bytes(tmp_path / name, "the mesh", 100, SpecimenError)
    assert no_file(tmp_path, folder=True) == ""


def test_a_file_that_says_nothing_of_its_size_is_bounded() -> None:
    with pytest.raises(InputError, match="it has more than the limit of 10 bytes"):
        read_bytes(Path("/proc/cpuinfo"), "it", 10)


def test_size_is_looked_at_before_reading(tmp_path: Path) -> None:
    with (tmp_path / "sparse").open("wb") as stream:
        stream.truncate(2**40)
    with pytest.raises(InputError, match=f"it has {2**40} bytes; the limit is 1000"):
        read_text(tmp_path / "sparse", "it", 1000)


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (ValueError("a\n  b"), r"x cannot be read \(ValueError: a b\)"),
        (KeyError("k"), r"x cannot be read \(KeyError: 'k'\)"),
        (RecursionError(), r"x cannot be read \(RecursionError\)"),
        (MemoryError(), "x cannot be read: it does not fit into memory"),
        (OSError(5, "Input/output error"), r"x cannot be read \(OSError: Input/output error\)"),
        (ValueError("y" * 5000), r"x cannot be read \(ValueError: y{200,300}\.\.\.\)"),
    ],
)
def test_whatever_a_library_throws_is_one_sentence(error: Exception, said: str) -> None:
    with pytest.raises(TrajectoryError, match=f"^{said}$"), library_errors("x", TrajectoryError):
        raise error
    with pytest.raises(SpecimenError, match="^own$"), library_errors("x"):
        raise SpecimenError("own")


def test_memory_is_that_of_this_process() -> None:
    require_memory("x", 1.0)
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (2**40, hard))
    try:
        with pytest.raises(InputError, match="x needs 2.05e.03 GiB of memory"):
            require_memory("x", 2**41)
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def test_names_that_no_file_has() -> None:
    assert absolute(Path("/a"), "../b") == Path("/b")
    for name in ("a\0b", "~nobody-of-this-name/x"):
        with pytest.raises(ValueError, match="is not a valid file name"):
            absolute(Path("/a"), name)
