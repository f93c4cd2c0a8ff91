"""What a coarser level leaves to the next one."""

import numpy as np
import pytest

from twinct.geometry import Panel, VolumeGrid
from twinct.recon import Projector
from twinct.recon.levels import Rest

FAINT = 0.01
"""Attenuation of a body that stays as it is, beside a dense one of 1."""

OFF = 0.25
"""Pixels by which the middle of its shadow may be off; half a larger pixel would be one or two."""

LESS = 0.03
"""Share of its attenuation that may be missing: blocks of the dense body hold some of it."""


def middles(images):
    """Return the mean row and column of each image, weighted by its values."""
    total = images.sum((1, 2))
    rows, columns = np.ogrid[: images.shape[1], : images.shape[2]]
    return (
        np.stack([(images * rows).sum((1, 2)), (images * columns).sum((1, 2))], 1) / total[:, None]
    )


@pytest.mark.parametrize("beyond", [False, True])
def test_a_quiet_rest_is_projected_where_it_lies(circle, ellipsoid_integrals, beyond):
    """In pixels four times as large if nothing lies beyond the grid, else twice as large."""
    geometry, finer = circle(8, Panel(64, 104, 2.0, 2.0)), VolumeGrid((64, 64, 64), 1.0)
    coarse = VolumeGrid((44, 44, 44) if beyond else (32, 32, 32), 2.0)
    centre, semi_axes = np.array((-19.0, 4, 9)), np.array((9.0, 7, 11))
    z, y, x = coarse.axes()[2][:, None, None], coarse.axes()[1][:, None], coarse.axes()[0]
    shares = sum(
        (((x + dx - centre[0]) / semi_axes[0]) ** 2)
        + (((y + dy - centre[1]) / semi_axes[1]) ** 2)
        + (((z + dz - centre[2]) / semi_axes[2]) ** 2)
        < 1
        for dx in (-0.5, 0.5)
        for dy in (-0.5, 0.5)
        for dz in (-0.5, 0.5)
    )
    volume = (FAINT / 8 * shares).astype(np.float32)
    volume[(x - 20) ** 2 + y**2 + z**2 < 36] = 1
    rest = Rest.of(Projector(geometry.binned(2, 2), coarse), volume, finer, beyond=beyond)
    assert rest.images is not None
    assert rest.images.shape[1:] == ((32, 52) if beyond else (16, 26))
    found = np.stack([rest.at(view, geometry.panel.shape) for view in range(8)])
    exact = FAINT * ellipsoid_integrals(geometry, centre, semi_axes)
    np.testing.assert_allclose(middles(found), middles(exact), rtol=0, atol=OFF)
    np.testing.assert_allclose(found.sum((1, 2)), exact.sum((1, 2)), rtol=LESS)
