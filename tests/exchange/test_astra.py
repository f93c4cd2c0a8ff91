"""ASTRA's own C++ geometry, made from the exported numbers, projects points where twinct does.

ASTRA's 3-D projectors need CUDA; its geometry classes do not. ``projectPoint`` is not part of its
Python interface, so it is called in the library that Python loads.
"""

from __future__ import annotations

import ctypes
import os
import runpy
import struct
from pathlib import Path

import numpy as np
import pytest

from twinct.exchange import write_bundle
from twinct.geometry import Panel, ScanGeometry

astra = pytest.importorskip("astra", reason="needs astra-toolbox")

POINT_PX = 1e-9
"""Float64 on both sides; measured 1e-13."""


class AstraGeometry:
    """The ``CConeVecProjectionGeometry3D`` that ASTRA made of a ``cone_vec`` dict."""

    def __init__(self, geometry: dict) -> None:
        library = ctypes.CDLL(str(Path(astra.__file__).parent / "libastra.so.0"))
        manager = library["_ZN5astra9SingletonINS_14CData3DManagerEE12getSingletonEv"]
        manager.restype = ctypes.c_void_p
        get = library["_ZNK5astra19CAstraObjectManagerINS_7CData3DEE3getEi"]
        get.restype, get.argtypes = ctypes.c_void_p, [ctypes.c_void_p, ctypes.c_int]
        name = "_ZNK5astra28CConeVecProjectionGeometry3D12projectPointEdddiRdS1_"
        self._project = library[name]
        number = ctypes.POINTER(ctypes.c_double)
        self._project.argtypes = [
            ctypes.c_void_p, *[ctypes.c_double] * 3, ctypes.c_int, number, number,
        ]  # fmt: skip
        self._project.restype = None
        self._data = astra.data3d.create("-sino", geometry)
        table = ctypes.c_char.in_dll(library, "_ZTVN5astra28CConeVecProjectionGeometry3DE")
        self._geometry = _find(get(manager(), self._data), ctypes.addressof(table) + 16)

    def project(self, view: int, point: np.ndarray) -> tuple[float, float]:
        """Fractional (column, row)."""
        column, row = ctypes.c_double(), ctypes.c_double()
        self._project(self._geometry, *point.tolist(), view, column, row)
        return column.value, row.value

    def close(self) -> None:
        astra.data3d.delete(self._data)


def _find(holder: int, table: int) -> int:
    """The member of an object that points to an object of the class with that virtual table."""
    memory = os.open("/proc/self/mem", os.O_RDONLY)

    def word(address: int) -> int:
        try:
            return struct.unpack("Q", os.pread(memory, 8, address))[0]
        except (OSError, OverflowError):
            return 0

    try:
        members = [word(holder + 8 * i) for i in range(32)]
        return next(member for member in members if member and word(member) == table)
    finally:
        os.close(memory)


@pytest.fixture
def loaded(bundle, tmp_path):
    write_bundle(tmp_path / "astra", "astra", bundle)
    return runpy.run_path(str(tmp_path / "astra" / "load.py"))


def test_points_reproject_through_astras_own_geometry(loaded, bundle, points) -> None:
    geometry, _, _ = loaded["load"]()
    theirs = AstraGeometry(geometry)
    asked = bundle.local.project(points)
    for view in range(len(bundle.geometry)):
        seen = [theirs.project(view, point) for point in points]
        np.testing.assert_allclose(seen, asked[view], rtol=0, atol=POINT_PX)
    theirs.close()


def test_astra_takes_images_and_volume_in_these_shapes(loaded, bundle, grid) -> None:
    geometry, voxels, images = loaded["load"]()
    sinogram = astra.data3d.create("-sino", geometry, images)
    volume = astra.data3d.create("-vol", voxels, 0)
    assert astra.data3d.dimensions(volume) == grid.shape
    np.testing.assert_array_equal(
        np.swapaxes(astra.data3d.get(sinogram), 0, 1), np.asarray(bundle.images)
    )
    option = voxels["option"]
    edges = [option[f"Window{side}{axis}"] for axis in "XYZ" for side in ("Max", "Min")]
    np.testing.assert_allclose(np.reshape(edges, (3, 2)) @ (1, -1), grid.size_mm)
    np.testing.assert_allclose(np.reshape(edges, (3, 2)) @ (1, 1), 0, atol=1e-12)
    astra.data3d.delete([sinogram, volume])


def test_a_circle_is_the_one_that_astra_makes(panel) -> None:
    angles = np.linspace(0, 2 * np.pi, 7, endpoint=False)
    circle = astra.create_proj_geom(
        "cone", panel.pitch_u, panel.pitch_v, *panel.shape, angles, 300.0, 250.0
    )
    towards = np.stack([np.sin(angles), -np.cos(angles), 0 * angles], axis=1)
    u = np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
    v = np.tile([0.0, 0.0, 1.0], (7, 1))
    ours = ScanGeometry(300 * towards, -250 * towards, u, v, Panel(*panel.shape, 2.3, 1.9))
    np.testing.assert_allclose(ours.to_astra()["Vectors"], astra.geom_2vec(circle)["Vectors"])
