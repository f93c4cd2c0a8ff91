"""Folders of TIFF files that one program wrote: read fast, and still judged one by one."""

from __future__ import annotations

import numpy as np
import pytest
import tifffile

from twinct.core.errors import InputError
from twinct.measured.description import Files
from twinct.measured.stack import open_stack

COUNT = 40


@pytest.fixture
def write(tmp_path):
    """A function that writes one more image, and returns its path."""
    count = iter(range(COUNT))

    def run(image, **keys):
        number = next(count)
        path = tmp_path / f"a_{number:04d}.tif"
        when = f"2026:11:29 12:00:{number:02d}"
        tifffile.imwrite(path, image, datetime=when, **keys)
        return path

    return run


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("kind", ["u1", "u2", "f4"])
def test_only_the_first_of_files_alike_is_read_tag_by_tag(
    order, kind, write, tmp_path, monkeypatch
):
    rng = np.random.default_rng(1)
    images = rng.integers(0, 250, (COUNT, 6, 4)).astype(kind)
    for image in images:
        write(image, byteorder=order, rowsperstrip=2)
    opened, real = [], tifffile.TiffFile
    monkeypatch.setattr(tifffile, "TiffFile", lambda path: opened.append(path) or real(path))
    stack = open_stack(Files(path=str(tmp_path)), "images")
    assert {path.name for path in opened} == {"a_0000.tif"}
    assert stack.dtype == images.dtype
    np.testing.assert_array_equal([stack.image(v) for v in range(COUNT)], images)


@pytest.mark.parametrize("other", [np.zeros((4, 6), "u2"), np.zeros((6, 5), "u2"), "i2"])
def test_a_file_that_differs_is_named(other, write, tmp_path):
    for view in range(8):
        image = np.full((6, 4), view, "u2")
        differs = image.astype(other) if isinstance(other, str) else other
        write(differs if view == 5 else image)
    with pytest.raises(InputError, match="a_0005.tif: images of .* image 5 must have the size"):
        open_stack(Files(path=str(tmp_path)), "images")


def test_files_of_other_layouts_are_read_by_the_library(write, tmp_path):
    images = np.random.default_rng(2).integers(0, 60000, (8, 6, 4)).astype("u2")
    for view, image in enumerate(images):
        write(image, **({"compression": "zlib"} if view % 2 else {"description": "x" * view}))
    stack = open_stack(Files(path=str(tmp_path)), "images")
    np.testing.assert_array_equal([stack.image(v) for v in range(8)], images)


def test_a_file_that_was_cut_is_named(write, tmp_path):
    paths = [write(np.full((6, 4), view, "u2")) for view in range(4)]
    stack = open_stack(Files(path=str(tmp_path)), "images")
    paths[2].write_bytes(paths[2].read_bytes()[:-20])
    with pytest.raises(InputError, match="image 2: .*a_0002.tif|a_0002.tif"):
        stack.image(2)
