"""Damaged images and images in other files: refused with the file, wherever the damage lies."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.measured.description import Files
from twinct.measured.stack import open_stack

h5py = pytest.importorskip("h5py", reason="part of the development environment")
COUNTS = np.random.default_rng(0).integers(0, 60000, (3, 5, 7)).astype(np.uint16)


def read(path, array=""):
    stack = open_stack(Files(path=str(path), array=array), "images")
    return np.array([stack.image(k) for k in range(stack.count)])


def as_hdf5(folder):
    with h5py.File(folder / "a.h5", "w") as file:
        keys = {"chunks": (1, 5, 7), "compression": "gzip", "shuffle": True, "fletcher32": True}
        file.create_dataset("scan/a", data=COUNTS, **keys)
    return folder / "a.h5"


def as_zarr(folder):
    import zarr

    zarr.create_array(str(folder / "a.zarr"), data=COUNTS, chunks=(1, 5, 7))
    return folder / "a.zarr"


@pytest.mark.parametrize("write", [as_hdf5, as_zarr])
def test_a_damaged_chunk_is_named_with_its_image(tmp_path, write):
    path = write(tmp_path)
    assert (read(path) == COUNTS).all()
    if write is as_hdf5:
        with h5py.File(path, "r+") as file:
            file["scan/a"].id.write_direct_chunk((1, 0, 0), b"rubbish")
    else:
        file = path / "c" / "1" / "0" / "0"
        file.write_bytes(file.read_bytes()[:-9])
    stack = open_stack(Files(path=str(path)), "images")
    assert (stack.image(0) == COUNTS[0]).all()
    with pytest.raises(InputError) as refusal:
        stack.image(1)
    assert str(path) in str(refusal.value)
    assert "image 1 cannot be read" in str(refusal.value) or "damaged" in str(refusal.value)


@pytest.mark.parametrize("write", [as_hdf5, as_zarr])
def test_any_wrong_byte_gives_values_or_a_refusal(tmp_path, write):
    """A byte anywhere, in metadata and chunks alike."""
    path, rng = write(tmp_path), np.random.default_rng(5)
    files = sorted(f for f in (path.rglob("*") if path.is_dir() else [path]) if f.is_file())
    refused = 0
    for _ in range(150):
        file = files[rng.integers(len(files))]
        whole = file.read_bytes()
        data = bytearray(whole)
        data[rng.integers(len(data))] ^= 1 << rng.integers(8)
        file.write_bytes(data)
        try:
            read(path)
        except InputError as refusal:
            assert str(path) in str(refusal)
            refused += 1
        file.write_bytes(whole)
    assert refused > 15


def external_storage(folder):
    (folder / "secret.bin").write_bytes(COUNTS.tobytes())
    with h5py.File(folder / "a.h5", "w") as file:
        outside = [(str(folder / "secret.bin"), 0, COUNTS.nbytes)]
        file.create_dataset("a", COUNTS.shape, "u2", external=outside)


def virtual(folder):
    with h5py.File(folder / "secret.bin", "w") as file:
        file["a"] = COUNTS
    layout = h5py.VirtualLayout(COUNTS.shape, "u2")
    layout[:] = h5py.VirtualSource(str(folder / "secret.bin"), "a", COUNTS.shape)
    with h5py.File(folder / "a.h5", "w") as file:
        file.create_virtual_dataset("a", layout)


def external_link(folder):
    with h5py.File(folder / "secret.bin", "w") as file:
        file["a"] = COUNTS
    with h5py.File(folder / "a.h5", "w") as file:
        file["a"] = h5py.ExternalLink(str(folder / "secret.bin"), "a")


def soft_then_external(folder):
    external_link(folder)
    with h5py.File(folder / "a.h5", "r+") as file:
        file["b"] = np.zeros((3, 5, 7))
        file.move("a", "c")
        file["a"] = h5py.SoftLink("/c")


@pytest.mark.parametrize("write", [external_storage, virtual, external_link, soft_then_external])
@pytest.mark.parametrize("array", ["a", ""])
def test_images_in_another_file_are_not_read(tmp_path, write, array):
    write(tmp_path)
    if write is soft_then_external and not array:
        assert not read(tmp_path / "a.h5").any()  # the only array of the file itself
        return
    with pytest.raises(InputError, match="in another file, .*secret.bin") as refusal:
        read(tmp_path / "a.h5", array)
    assert str(tmp_path / "a.h5") in str(refusal.value)


def test_a_link_within_the_file_is_followed(tmp_path):
    path = as_hdf5(tmp_path)
    with h5py.File(path, "r+") as file:
        file["entry"] = h5py.SoftLink("/scan")
        file["round"] = h5py.SoftLink("/round")
    assert (read(path, "entry/a") == COUNTS).all()
    with pytest.raises(InputError, match="leads from link to link"):
        read(path, "round")


def test_other_filters_are_named(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("a", data=COUNTS, chunks=(1, 5, 7), scaleoffset=16)
    with pytest.raises(InputError, match="HDF5's filter 6, which is not read: h5repack"):
        read(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("a", data=COUNTS, chunks=(1, 5, 7), compression="lzf")
    assert (read(tmp_path / "a.h5") == COUNTS).all()


def test_a_frame_of_another_size_than_stated_is_not_decoded(tmp_path):
    import io

    import bombs
    from PIL import Image
    from pydicom.encaps import encapsulate
    from pydicom.uid import JPEGBaseline8Bit

    stream = io.BytesIO()
    Image.new("L", (40, 30)).save(stream, "JPEG")
    bombs.write_dicom(tmp_path, JPEGBaseline8Bit, encapsulate([stream.getvalue()]), 16)
    with pytest.raises(InputError, match="a.dcm: frame 0 has 30 x 40 pixels; .* states 16 x 16"):
        read(tmp_path / "a.dcm")
