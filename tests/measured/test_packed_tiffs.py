"""TIFF images that are packed: LZW is read bit by bit, other ways are named."""

from __future__ import annotations

import numpy as np
import pytest
import tifffile
from PIL import Image

from twinct.core.errors import InputError
from twinct.core.files.images import read_image
from twinct.measured.description import Files
from twinct.measured.stack import open_stack

COUNTS = np.random.default_rng(0).integers(0, 60000, (3, 40, 70)).astype(np.uint16)


def read(path):
    stack = open_stack(Files(path=str(path)), "images")
    return np.array([stack.image(k) for k in range(stack.count)])


@pytest.mark.parametrize("dtype", ["u1", "u2", ">u2", "i4", "f4"])
@pytest.mark.parametrize("predictor", [1, 2])
def test_lzw_gives_the_stored_numbers(dtype, predictor, tmp_path):
    images = (COUNTS % 251 if dtype == "u1" else COUNTS).astype(dtype)
    if dtype == "f4":
        images, predictor = images / 7 - 300, 3 if predictor == 2 else 1
    pages = [Image.fromarray(image) for image in images]
    keys = {"compression": "tiff_lzw", "tiffinfo": {317: predictor}}
    for index, page in enumerate(pages):
        page.save(tmp_path / f"{index}.tif", **keys)
    found = read(tmp_path)
    assert found.dtype == images.dtype.newbyteorder("=")
    np.testing.assert_array_equal(found, images)
    stacked = tmp_path / "all" / "a.tif"
    stacked.parent.mkdir()
    pages[0].save(stacked, save_all=True, append_images=pages[1:], **keys)
    with tifffile.TiffFile(stacked) as file:
        assert {int(page.compression) for page in file.pages} == {5}
    np.testing.assert_array_equal(read(stacked), images)


def relabel(path, tag, value):
    """Write another number into a tag of a TIFF file's first page."""
    with tifffile.TiffFile(path, mode="r+") as file:
        file.pages[0].tags[tag].overwrite(value)


def test_lzw_of_types_that_pillow_calls_by_another_name(tmp_path):
    """Signed, unsigned and dark-is-large numbers are the bits in the file."""
    path = tmp_path / "a.tif"
    for dtype, other in (("u2", "i2"), ("i4", "u4"), ("u1", "i1")):
        image = (COUNTS[0] % 251 if dtype == "u1" else COUNTS[0]).astype(dtype)
        image[0, 0] = -3 if dtype == "i4" else image[0, 0]
        Image.fromarray(image).save(path, compression="tiff_lzw", tiffinfo={339: 2})
        if other == "u4":
            relabel(path, "SampleFormat", 1)
        found = read(path)[0]
        assert found.dtype == other
        np.testing.assert_array_equal(found, image.view(other))
    Image.fromarray(image).save(path, compression="tiff_lzw")
    relabel(path, "PhotometricInterpretation", 0)
    np.testing.assert_array_equal(read(path)[0], image)


def test_a_map_of_bad_pixels_may_be_packed(tmp_path):
    Image.fromarray(COUNTS[0]).save(tmp_path / "a.tif", compression="tiff_lzw")
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif", "bad pixels"), COUNTS[0])


def test_other_ways_of_packing_are_named(tmp_path):
    path = tmp_path / "a.tif"
    Image.fromarray((COUNTS[0] % 251).astype(np.uint8)).save(path, compression="jpeg")
    with pytest.raises(InputError, match="a.tif: TIFF compression JPEG is not read: store the"):
        read(path)
    Image.fromarray(COUNTS[0]).save(path, compression="tiff_lzw")
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(InputError, match=r"a.tif"):
        read(path)
