"""What lies in the folder, and what is refused before there is one."""

from __future__ import annotations

import dataclasses
import errno
import hashlib
import json
import py_compile
import runpy
import subprocess
import sys

import numpy as np
import pytest

from twinct.core.errors import InputError, ScanExistsError
from twinct.exchange import BUILT_IN, Bundle, bundle_bytes, write_bundle
from twinct.exchange.format import Format
from twinct.geometry import Panel, ScanGeometry, VolumeGrid


@pytest.fixture(params=BUILT_IN)
def toolkit(request):
    return request.param


def test_a_folder_says_what_it_holds(toolkit, bundle, grid, tmp_path) -> None:
    folder = tmp_path / "there" / "export"
    write_bundle(folder, toolkit, bundle)
    files = {file.name for file in folder.iterdir()}
    own = {
        "rtk": {"geometry.xml", "projections.mha"},
        "openct": {"openct.json", "projections"},
    }.get(toolkit, {"geometry.npz", "projections.npy"})
    assert files == {"README.txt", "load.py", "export.json"} | own
    py_compile.compile(str(folder / "load.py"), str(tmp_path / "compiled"), doraise=True)
    facts = json.loads((folder / "export.json").read_text())
    assert facts["scan"] == "test" and facts["values"].startswith("line integrals -ln(I/I0)")
    assert facts["projections"]["shape_view_row_column"] == list(bundle.images.shape)
    np.testing.assert_allclose(facts["volume"]["world_from_voxel"], grid.affine)
    readme = (folder / "README.txt").read_text()
    assert "1/mm, 46 views of 31 x 37" in readme
    assert "20 x 26 x 24 voxels, 2 x 2 x 2.6 mm" in readme or toolkit == "openct"
    size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file())
    assert size < bundle_bytes(bundle.geometry)


@pytest.mark.parametrize("toolkit", ["astra", "leap", "cil", "tigre"])
def test_load_py_reads_the_arrays_with_numpy_alone(toolkit, bundle, tmp_path) -> None:
    write_bundle(tmp_path / "export", toolkit, bundle)
    images, words = runpy.run_path(str(tmp_path / "export" / "load.py"))["arrays"]()
    assert images.dtype == np.float32
    np.testing.assert_array_equal(images, bundle.images)
    per_view = [name for name, array in words.items() if len(array) == len(images)]
    assert per_view and all(np.isfinite(array).all() for array in words.values())


@pytest.mark.process
def test_load_py_runs_as_a_user_runs_it(bundle, tmp_path) -> None:
    pytest.importorskip("astra", reason="needs astra-toolbox")
    write_bundle(tmp_path / "export", "astra", bundle)
    result = subprocess.run(
        [sys.executable, str(tmp_path / "export" / "load.py")],
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert result.returncode == 0, result.stderr
    assert "46 views, images (row, view, column) (31, 46, 37)" in result.stdout


def test_an_existing_folder_is_not_touched(bundle, tmp_path) -> None:
    (tmp_path / "export").mkdir()
    with pytest.raises(ScanExistsError, match="export already exists"):
        write_bundle(tmp_path / "export", "astra", bundle)
    assert not list((tmp_path / "export").iterdir())


def test_nothing_is_left_of_an_export_that_failed(toolkit, bundle, tmp_path) -> None:
    def images():
        yield bundle.images[0]
        raise OSError(errno.ENOSPC, "No space left on device")

    broken = dataclasses.replace(bundle, images=images())
    with pytest.raises(OSError, match="No space"):
        write_bundle(tmp_path / "export", toolkit, broken)
    assert not list(tmp_path.iterdir())


def test_a_refusal_comes_before_anything_is_written(bundle, tmp_path) -> None:
    flat = dataclasses.replace(bundle, grid=VolumeGrid((4, 4, 4), (1.0, 2.0, 1.0)))
    with pytest.raises(InputError, match="LEAP"):
        write_bundle(tmp_path / "export", "leap", flat)
    assert not list(tmp_path.iterdir())


CONTENTS = {
    "rtk": "1f5df658844e2241da7e50957a13169bb0092aa35e9a846d0de005bb4b85877f",
    "astra": "7a9124d40b1079079327e58bf09d63cebf60d6c2ec3f1c08f6df2543e24c2b97",
    "leap": "9466933221141cf64a8e47428f8a532cd33c5d48d098c91a1459ff327739e0d9",
    "cil": "bfc3b19db552a7555856c6fbaeaca2f7a634317fff068022ffc6c74e980c1a83",
    "tigre": "6af47c30413e81f2caaf913626c239c5a41d88474810ed208cd17af869c06a51",
    "openct": "da25948c14c9b2de5a7d91a7e4ac909687e0c2bb46d06c3ae34943368b1bba4f",
}
"""SHA-256 of all files of a format, of three views along the axes, as version 0.1 wrote them."""


def test_the_files_of_a_format_stay_as_they_are(toolkit, tmp_path) -> None:
    x, y, z = 300 * np.eye(3)
    u, v = np.eye(3)[[1, 2, 0]], np.eye(3)[[2, 0, 1]]
    views = ScanGeometry([x, y, z], [-x, -y, -z], u, v, Panel(3, 4, 2.0, 1.5))
    images = np.arange(36, dtype=np.float32).reshape(3, 3, 4)
    grid = VolumeGrid((4, 5, 6), (2.0, 2.0, 2.5))
    origin = {"scan": "axes", "views": "3 of 3"}
    write_bundle(tmp_path / "out", toolkit, Bundle(views, grid, images, "transmission", origin))
    content = hashlib.sha256()
    for file in sorted(file for file in (tmp_path / "out").rglob("*") if file.is_file()):
        content.update(str(file.relative_to(tmp_path)).encode())
        if file.suffix == ".npz":  # an archive, whose own bytes are those of Python's library
            for name, array in sorted(np.load(file).items()):
                content.update(f"{name} {array.dtype} {array.shape}".encode() + array.tobytes())
        else:
            content.update(file.read_bytes())
    assert content.hexdigest() == CONTENTS[toolkit]


def test_the_name_of_a_format_is_part_of_a_folders_name() -> None:
    with pytest.raises(ValueError, match="name 'a/b': use letters"):
        Format("a/b", "", {}, lambda bundle, out: None, "")
