"""MTF of spheres and wires that were blurred by a known kernel."""

import math

import numpy as np
import pytest
from scipy import ndimage

from twinct.core.errors import InputError
from twinct.evaluation.mtf import Mtf, edge_mtf

MTF_TOLERANCE = 0.03
"""Asked for, down to an MTF of 0.1."""


def rings(shape, voxel, centre):
    index = np.indices(shape, dtype=float)
    return np.sqrt(sum((i * voxel - c) ** 2 for i, c in zip(index, centre, strict=True)))


def blurred(shape, voxel, centre, radius, sigma):
    """A body of 1, supersampled by 4, blurred, then taken at the voxels' centres."""
    fine, over = voxel / 4, [4 * n for n in shape]
    shifted = [c + 1.5 * fine for c in centre]
    body = np.clip((radius - rings(over, fine, shifted)) / fine + 0.5, 0, 1)
    soft = ndimage.gaussian_filter(body, sigma / fine, truncate=6)
    return soft[(slice(1, None, 4),) * len(shape)], [c + 0.5 * fine for c in centre]


def worst(found: Mtf, sigma: float) -> float:
    expected = np.exp(-2 * (np.pi * sigma * found.frequency_per_mm) ** 2)
    counts = expected >= 0.1
    assert counts.sum() > 30
    return float(np.abs(found.value - expected)[counts].max())


@pytest.mark.parametrize("sigma", [0.8, 1.2])
def test_a_blurred_sphere(sigma, figure) -> None:
    shape, voxel, radius = (40, 41, 42), 1.0, 11.0
    volume, centre = blurred(shape, voxel, (19.3, 20.6, 20.2), radius, sigma)
    found = edge_mtf(volume, rings(shape, voxel, centre) - radius, radius, voxel)
    figure(f"MTF of a sphere, sigma {sigma} voxels: off by {worst(found, sigma):.4f}")
    assert worst(found, sigma) < MTF_TOLERANCE
    expected = math.sqrt(math.log(10) / 2) / (math.pi * sigma)
    assert found.falls_to(0.1) == pytest.approx(expected, rel=0.03)
    # Its contrast and what surrounds it have no influence.
    other = edge_mtf(5 - 3 * volume, rings(shape, voxel, centre) - radius, radius, voxel)
    np.testing.assert_allclose(other.value, found.value, atol=1e-12)


def test_a_small_sphere_is_corrected_for_its_curvature(figure) -> None:
    shape, voxel, radius, sigma = (26, 26, 26), 1.0, 5.0, 1.0
    volume, centre = blurred(shape, voxel, (12.3, 12.6, 12.2), radius, sigma)
    offset = rings(shape, voxel, centre) - radius
    errors = [worst(edge_mtf(volume, offset, radius, voxel, c), sigma) for c in (2, 0)]
    figure(f"MTF of a small sphere: off by {errors[0]:.4f}; by {errors[1]:.4f} as of a plane")
    assert errors[0] < MTF_TOLERANCE and errors[0] < errors[1]


def test_a_wire(figure) -> None:
    shape, voxel, radius, sigma = (90, 91), 0.5, 6.0, 0.6
    image, centre = blurred(shape, voxel, (22.4, 22.9), radius, sigma)
    offset = rings(shape, voxel, centre) - radius
    found = worst(edge_mtf(image, offset, radius, voxel, curved=1), sigma)
    figure(f"MTF of a wire: off by {found:.4f}")
    assert found < MTF_TOLERANCE


def test_between_and_beyond_its_frequencies() -> None:
    mtf = Mtf(np.array([0.0, 1.0, 2.0]), np.array([1.0, 0.5, 0.3]))
    np.testing.assert_allclose(mtf([0.5, 2.0, 3.0]), [0.75, 0.3, 0.0])
    assert mtf.falls_to(0.4) == pytest.approx(1.5)
    assert math.isnan(mtf.falls_to(0.1))


def test_what_has_none() -> None:
    offset = rings((20, 20, 20), 1.0, (9.5, 9.5, 9.5)) - 5
    with pytest.raises(InputError, match="without contrast"):
        edge_mtf(np.ones(offset.shape), offset, 5.0, 1.0)
    with pytest.raises(InputError, match="too few voxels"):
        edge_mtf(offset, offset + 4, 1.0, 1.0)
