"""What lies in the folder, and what is refused before there is one."""

from __future__ import annotations

import dataclasses
import errno
import json
import py_compile
import runpy
import subprocess
import sys

import numpy as np
import pytest

from twinct.core.errors import InputError, ScanExistsError
from twinct.exchange import TOOLKITS, bundle_bytes, write_bundle
from twinct.geometry import VolumeGrid


@pytest.fixture(params=TOOLKITS)
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
