"""Images and volumes in larger pixels and voxels."""

import numpy as np
import pytest
from scipy import ndimage

from twinct.recon.resolution import Interpolation, blended

ROUNDING = 1e-6
"""Float32 rounding of values below 1."""


@pytest.mark.parametrize("shape", [(5, 7), (1, 4), (3, 1), (1, 1)])
def test_blended_images_agree_with_scipy(shape: tuple[int, int]) -> None:
    """Also beyond the image, where its outermost pixels continue."""
    image = np.random.default_rng(1).random(shape, np.float32)
    places = np.linspace(-1.5, shape[0] + 0.7, 23), np.linspace(-0.8, shape[1] + 1.5, 31)
    rows, columns = (Interpolation.places(one, n) for one, n in zip(places, shape, strict=True))
    expected = ndimage.map_coordinates(
        image, np.meshgrid(*places, indexing="ij"), order=1, mode="nearest"
    )
    np.testing.assert_allclose(blended(image, rows, columns), expected, rtol=0, atol=ROUNDING)
