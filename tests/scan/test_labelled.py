"""Scan and volume as labelled arrays; a stand-in for xarray, no dependency, notes the calls."""

from __future__ import annotations

import sys
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from twinct import load_scenario, simulate
from twinct.core.errors import InputError
from twinct.geometry import Pose, VolumeGrid
from twinct.recon.volume import Volume
from twinct.scan import Scan


@pytest.fixture
def xarray(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """What is used of xarray: it keeps the arguments, and refuses what xarray refuses."""

    def variable(told: Any, sizes: dict[str, int]) -> np.ndarray:
        dims, values = told[:2]
        dims = (dims,) if isinstance(dims, str) else dims
        assert np.shape(values) == tuple(sizes[dim] for dim in dims)
        return values

    def data_array(data: Any, *, coords: Any, dims: Any, name: str, attrs: Any) -> SimpleNamespace:
        sizes = dict(zip(dims, data.shape, strict=True))
        its = {key: variable(told, sizes) for key, told in coords.items()}
        return SimpleNamespace(values=data, coords=its, dims=dims, name=name, attrs=attrs)

    def dataset(variables: Any, *, coords: Any, attrs: Any) -> SimpleNamespace:
        its = {k: c[1] if isinstance(c, tuple) else np.asarray(c) for k, c in coords.items()}
        sizes = {key: len(values) for key, values in its.items()}
        found = {key: variable(told, sizes) for key, told in variables.items()}
        return SimpleNamespace(**found, coords=its, attrs=attrs)

    made = SimpleNamespace(DataArray=data_array, Dataset=dataset)
    monkeypatch.setitem(sys.modules, "xarray", made)
    return made


@pytest.fixture(scope="module")
def scan() -> Scan:
    keys = {
        "trajectory.views": 3,
        "xray.engine": "mesh",
        "detector": {"columns": 12, "rows": 8, "pixel_pitch_mm": [20, 25]},
        "specimen.parts": [{"shape": {"kind": "sphere", "radius_mm": 40}}],
    }
    return simulate(load_scenario("circle_gantry", keys))


def test_a_volume_keeps_its_memory_and_gets_its_places(xarray: SimpleNamespace) -> None:
    grid = VolumeGrid((3, 4, 5), (1.0, 2.0, 3.0), Pose.from_euler([10, 20, 30], [0, 0, 90]))
    volume = Volume(np.arange(60, dtype=np.float32).reshape(3, 4, 5), grid)
    made = volume.to_xarray()
    assert np.shares_memory(made.values, volume.array)
    assert made.dims == ("z", "y", "x") and made.attrs["units"] == "1/mm"
    at = np.array([made.coords[name][1] for name in "xyz"])
    index = np.array(made.attrs["world_from_index"]) @ [1, 1, 1, 1]
    np.testing.assert_allclose(grid.world_from_grid.apply(at), index[:3])


def test_a_scan_keeps_its_images_and_one_geometry(xarray: SimpleNamespace, scan: Scan) -> None:
    made = scan.to_xarray("executed")
    assert np.shares_memory(made.transmission, scan.transmission)
    np.testing.assert_array_equal(made.source, scan.geometry("executed").source)
    assert made.attrs["geometry"] == "executed"
    np.testing.assert_allclose(np.diff(made.coords["column"]), 20)
    np.testing.assert_allclose(np.diff(made.coords["row"]), 25)
    # A pixel lies where the geometry says.
    u, v = made.coords["column"][3], made.coords["row"][2]
    pixel = made.detector[1] + u * made.u[1] + v * made.v[1]
    panel, view = scan.scenario.detector.panel, scan.geometry("executed")
    first = view.detector[1] - (panel.columns - 1) / 2 * panel.pitch_u * view.u[1]
    first = first - (panel.rows - 1) / 2 * panel.pitch_v * view.v[1]
    np.testing.assert_allclose(pixel, first + 3 * 20 * view.u[1] + 2 * 25 * view.v[1])
    with pytest.raises(InputError, match="unknown geometry"):
        scan.to_xarray("imagined")


def test_without_xarray_the_message_says_how_to_get_it(
    monkeypatch: pytest.MonkeyPatch, scan: Scan
) -> None:
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(InputError, match="Scan.to_xarray needs xarray: python -m pip install xarr"):
        scan.to_xarray()
