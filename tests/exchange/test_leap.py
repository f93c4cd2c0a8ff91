"""LEAP's documented modular beam, written down again; LEAP itself is not on any package index."""

from __future__ import annotations

import runpy
from dataclasses import replace

import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.exchange import write_bundle
from twinct.exchange.leap import LEAP, leap_arrays
from twinct.geometry import VolumeGrid

SINGLE_PX = 5e-4
"""LEAP takes float32: 1e-7 of 350 mm, twice magnified, on pixels of 2 mm; measured 3e-5."""


def test_points_reproject_by_the_documented_formula(bundle, points, tmp_path) -> None:
    """s and t of set_modularbeam's docstring: y source, c module centre, u column, v row vector."""
    write_bundle(tmp_path / "leap", "leap", bundle)
    images, words = runpy.run_path(str(tmp_path / "leap" / "load.py"))["arrays"]()
    np.testing.assert_array_equal(images, bundle.images)
    y, c, v, u = (
        words[name] for name in ("sourcePositions", "moduleCenters", "rowVectors", "colVectors")
    )
    assert {array.dtype for array in (y, c, v, u)} == {np.dtype(np.float32)}
    (rows, columns), (height, width) = words["detector"], words["pixel"]
    n = np.cross(u, v)
    asked = bundle.local.project(points)
    for view in range(len(y)):
        rays, reach = points - y[view], c[view] - y[view]
        scale = (reach @ n[view]) / (rays @ n[view])
        s = scale * (rays @ u[view]) - reach @ u[view]
        t = scale * (rays @ v[view]) - reach @ v[view]
        seen = np.stack([s / width + (columns - 1) / 2, t / height + (rows - 1) / 2], axis=1)
        np.testing.assert_allclose(seen, asked[view], rtol=0, atol=SINGLE_PX)


def test_voxels_have_the_documented_centres(grid, free_views) -> None:
    words = leap_arrays(free_views, grid)
    width, height = words["voxel"]
    for count, edge, ours in zip(words["volume"], (width, width, height), grid.axes(), strict=True):
        np.testing.assert_allclose(edge * (np.arange(count) - (count - 1) / 2), ours)


def test_voxels_that_leap_does_not_have_are_refused(bundle) -> None:
    with pytest.raises(InputError, match="2 and 3 mm.*voxel_mm"):
        LEAP.check(replace(bundle, grid=VolumeGrid((4, 4, 4), (2.0, 3.0, 2.0))))
