"""Images of scans: one grey picture of the expected shape, judged by its header."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

from twinct.core.errors import InputError
from twinct.core.files.images import RawImage, read_image

SHAPE = (3, 4)
GREY = np.arange(12, dtype=np.uint8).reshape(SHAPE)


def png_of_zeros(path: Path, columns: int, rows: int) -> None:
    """Write a picture of any size in few bytes."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    header = chunk(b"IHDR", struct.pack(">IIBBBBB", columns, rows, 1, 0, 0, 0, 0))
    lines = zlib.compress(bytes((columns + 7) // 8 + 1) * rows)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", lines) + chunk(b"IEND", b""))


@pytest.mark.parametrize("name", ["a.png", "a.bmp", "a.tif", "a.npy", "a.raw"])
def test_grey_values_are_read_in_their_places(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    if name == "a.npy":
        np.save(path, GREY)
    elif name == "a.raw":
        path.write_bytes(b"head" + GREY.astype("<u2").tobytes())
    elif name == "a.tif":
        tifffile.imwrite(path, GREY)
    else:
        Image.fromarray(GREY).save(path)
    file = RawImage(path, "<u2", 4, 3, 4) if name == "a.raw" else path
    assert read_image(file, "it", SHAPE).tolist() == GREY.tolist()


def two_pages(path: Path) -> None:
    tifffile.imwrite(path, np.zeros((2, *SHAPE), np.uint8), photometric="minisblack")


def two_frames(path: Path) -> None:
    frames = [Image.fromarray(GREY + n) for n in (0, 100)]
    frames[0].save(path, save_all=True, append_images=frames[1:])


REFUSED: list[tuple[str, Callable[[Path], object], str]] = [
    ("a.png", lambda path: path.write_bytes(b"no picture"), "it does not hold a picture"),
    ("a.tif", lambda path: path.write_bytes(b"II*\0" + b"\xff" * 40), "does not hold a picture"),
    ("a.tif", two_pages, "it holds 2 pictures; expected one"),
    ("a.gif", two_frames, "it holds 2 pictures; expected one"),
    ("a.png", lambda path: png_of_zeros(path, 12_000, 12_000), r"has \(12000, 12000\) pixels"),
    ("a.png", lambda path: png_of_zeros(path, 30_000, 30_000), "states more pixels than"),
    ("a.npy", lambda path: np.save(path, np.zeros((4, 3))), r"has \(4, 3\) pixels, expected"),
    ("a.npy", lambda path: np.save(path, np.array(["a"])), "does not hold an array of numbers"),
    ("a.raw", lambda path: path.write_bytes(bytes(13)), "has 13 bytes, but"),
]


@pytest.mark.parametrize(("name", "write", "why"), REFUSED)
def test_what_is_no_such_picture_is_refused_by_its_header(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    name: str,
    write: Callable[[Path], object],
    why: str,
) -> None:
    write(path := tmp_path / name)
    monkeypatch.setattr("skimage.io.imread", lambda *_, **__: pytest.fail("the pixels were read"))
    file = RawImage(path, "u1", 4, 3, 0) if name == "a.raw" else path
    with pytest.raises(InputError, match=why) as caught:
        read_image(file, "bad pixels", SHAPE)
    assert str(caught.value).startswith(f"{path}: ")
    assert capfd.readouterr() == ("", "")
