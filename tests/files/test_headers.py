"""Headers that lie: arrays and volumes are refused before anything of their size is made."""

from __future__ import annotations

import gzip
import struct
import tracemalloc
import zipfile
from pathlib import Path

import nibabel
import numpy as np
import pytest

from twinct.core.errors import InputError, SpecimenError
from twinct.core.files.arrays import read_npy, read_npz
from twinct.core.files.meshes import read_triangles
from twinct.core.files.nifti import read_nifti


@pytest.fixture(autouse=True)
def _no_large_arrays():
    tracemalloc.start()
    yield
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 50e6


def npy(path: Path, shape: tuple[int, ...], dtype: str = "<f8") -> None:
    with path.open("wb") as stream:
        told = {"descr": dtype, "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(stream, told)
        stream.write(b"\0" * 80)


def test_arrays_have_the_bytes_that_they_tell_of(tmp_path: Path) -> None:
    npy(tmp_path / "right.npy", (5, 2))
    assert read_npy(tmp_path / "right.npy", "x").shape == (5, 2)
    for shape in ((10**12,), (-1, 5), (2**62, 2**62), ()):
        npy(tmp_path / "lie.npy", shape or (10,), "<f8" if shape else "|O")
        with pytest.raises(InputError, match="^x (cannot be read|holds Python objects)"):
            read_npy(tmp_path / "lie.npy", "x")
        with zipfile.ZipFile(tmp_path / "lie.npz", "w") as archive:
            archive.write(tmp_path / "lie.npy", "a.npy")
        with pytest.raises(InputError, match="^x (cannot be read|holds Python objects)"):
            read_npz(tmp_path / "lie.npz", "x", 2**20)


def test_what_unpacks_to_more_is_not_unpacked(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        with archive.open("a.npy", "w") as stream:
            for _ in range(64):
                stream.write(b"\0" * 2**20)
    with pytest.raises(InputError, match=f"x holds {2**26} bytes; the limit is {2**20}"):
        read_npz(tmp_path / "bomb.npz", "x", 2**20)


@pytest.mark.parametrize("packed", [False, True])
def test_a_volume_has_the_voxels_that_it_tells_of(tmp_path: Path, packed: bool) -> None:
    image = nibabel.Nifti1Image(np.arange(24, dtype=np.int16).reshape(2, 3, 4), np.eye(4))
    image.to_filename(tmp_path / "v.nii")
    data = bytearray((tmp_path / "v.nii").read_bytes())
    assert read_nifti(tmp_path / "v.nii", "x")[0][1, 2, 3] == 23
    data[42:48] = struct.pack("<3h", 30000, 30000, 30000)
    path = tmp_path / ("v.nii.gz" if packed else "v.nii")
    path.write_bytes(gzip.compress(data) if packed else data)
    with pytest.raises(InputError, match="x is cut off: its header states 54000000000000 bytes"):
        read_nifti(path, "x")


def test_meshes_have_the_elements_that_they_tell_of(tmp_path: Path) -> None:
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 99999999999\n"
    (tmp_path / "a.ply").write_text(f"{head}property float x\nend_header\n")
    with pytest.raises(SpecimenError, match="states 99999999999 elements"):
        read_triangles(tmp_path / "a.ply", "x")
    (tmp_path / "a.stl").write_bytes(b"\0" * 80 + struct.pack("<I", 2**32 - 1) + b"\0" * 50)
    with pytest.raises(SpecimenError, match="^x "):
        read_triangles(tmp_path / "a.stl", "x")
    (tmp_path / "a.off").write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 7\n")
    with pytest.raises(SpecimenError, match="^x "):
        read_triangles(tmp_path / "a.off", "x")


def test_a_mesh_opens_no_other_file(tmp_path: Path) -> None:
    """What would wait for a writer, if somebody looked for the material."""
    import os

    os.mkfifo(tmp_path / "other.mtl")
    text = "mtllib other.mtl\nusemtl x\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
    (tmp_path / "a.obj").write_text(text)
    assert len(read_triangles(tmp_path / "a.obj", "x").faces) == 1
