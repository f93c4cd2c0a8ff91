"""FDK of a panel that is shifted sideways, against an ellipsoid's value and against RTK."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from twinct.geometry import Panel, Pose, VolumeGrid
from twinct.recon import Projector, fdk

WIDE = Panel(24, 100, 1.5, 1.5)
"""A centred panel that sees the whole body; shifted ones see it on one side of the axis only."""

BODY = (3.0, -2.0, 0.0), (27.0, 24.0, 20.0)
GRID = VolumeGrid((3, 64, 64), 1.2)
MID_PLANE = 0.01
"""Largest error of the mean; measured 0.0001. With equal shares of all rays it is 0.26."""
SEEN_MM = 35.0
"""Radius that a turn sees."""
RTK = 1e-5
"""Largest relative RMS difference from RTK; measured 9e-7. With equal shares of all rays: 0.43."""


def shifted(geometry, columns, side):
    """Return the views with fewer columns, all at one side of the wide panel."""
    by = side * (WIDE.columns - columns) / 2 * WIDE.pitch_u
    panel = replace(geometry.panel, columns=columns)
    return replace(geometry, detector=geometry.detector + by * geometry.u, panel=panel)


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("side", [-1, 1])
def test_shifted_panel_gives_the_value_of_a_body_that_it_half_sees(
    side, backwards, circle, ellipsoid_integrals
):
    geometry = shifted(circle(200, WIDE), 62, side)[:: -1 if backwards else 1]
    volume = fdk(Projector(geometry, GRID), ellipsoid_integrals(geometry, *BODY))
    assert volume.extras["shifted_panel"] is not None
    (cx, cy, _), (a, b, _) = BODY
    x, y, _ = GRID.axes()
    square = ((x - cx) / a) ** 2 + (((y - cy) / b) ** 2)[:, None]
    body, air = volume.array[1][square < 0.8], volume.array[1][(square > 1.3) & seen()]
    assert abs(body.mean() - 1) < MID_PLANE
    assert np.abs(body - 1).max() < 3 * MID_PLANE
    assert abs(air.mean()) < MID_PLANE


def seen():
    """Return a mask of the voxels that a turn sees, (y, x)."""
    x, y, _ = GRID.axes()
    return np.hypot(x, y[:, None]) < SEEN_MM


def test_centred_panel_has_no_shift(circle, ellipsoid_integrals):
    geometry = circle(20, WIDE)
    volume = fdk(Projector(geometry, GRID), ellipsoid_integrals(geometry, *BODY))
    assert volume.extras["shifted_panel"] is None


@pytest.mark.tutorial
def test_rtk_with_its_displaced_detector_filter_agrees(circle, ellipsoid_integrals):
    itk: Any = pytest.importorskip("itk", reason="needs the extra rtk")
    geometry = shifted(circle(80, WIDE), 62, 1)
    p = ellipsoid_integrals(geometry, *BODY)
    ours = fdk(Projector(geometry, GRID), p).array
    theirs = rtk_fdk(itk, geometry, p)
    off = np.mean((ours - theirs)[:, seen()] ** 2) / np.mean(ours[:, seen()] ** 2)
    assert np.sqrt(off) < RTK


def rtk_fdk(itk: Any, geometry, p: np.ndarray) -> np.ndarray:
    """Return the volume of RTK's FDK after its displaced detector filter, (z, y, x)."""
    rtk, kind = itk.RTK, itk.Image[itk.F, 3]
    views = rtk.ThreeDCircularProjectionGeometry.New()
    # RTK turns about its y, which is our z here: (x, y, z) becomes (x, z, -y).
    numbers = (Pose.from_euler((0, 0, 0), (-90, 0, 0)) @ geometry).to_rtk()
    vectors = [numbers[key].tolist() for key in ("source", "detector", "row", "column")]
    for source, detector, row, column in zip(*vectors, strict=True):
        points = itk.Point[itk.D, 3](source), itk.Point[itk.D, 3](detector)
        assert views.AddProjection(*points, itk.Vector[itk.D, 3](row), itk.Vector[itk.D, 3](column))

    def image(array, spacing, origin):
        made = itk.image_from_array(np.ascontiguousarray(array, np.float32))
        made.SetSpacing([float(x) for x in spacing])
        made.SetOrigin([float(x) for x in origin])
        return made

    weighed = rtk.DisplacedDetectorImageFilter[kind].New()
    images = image(p, (*numbers["spacing"], 1.0), (*numbers["origin"], 0.0))
    weighed.SetInput(images)
    weighed.SetGeometry(views)
    fdk_filter = rtk.FDKConeBeamReconstructionFilter[kind].New()
    z, y, x = GRID.shape
    empty = image(np.zeros((y, z, x)), GRID.voxel, -(np.array([x, z, y]) - 1) / 2 * GRID.voxel)
    fdk_filter.SetInput(0, empty)
    fdk_filter.SetInput(1, weighed.GetOutput())
    fdk_filter.SetGeometry(views)
    fdk_filter.Update()
    return np.array(itk.array_from_image(fdk_filter.GetOutput()))[::-1].transpose(1, 0, 2)
