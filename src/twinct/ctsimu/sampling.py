"""Start and end points of rays: focal spot and pixel, sampled together.

For a point source, each pixel is divided into equal parts with one ray to the middle of each. For
an extended focal spot, 2 x 2 rays per pixel start from each of its points, each time to other
positions in the pixel, so that both averages come from the same passes over the panel. The points
are Halton's sequence in four dimensions, ranked along each axis. With 32 points, the frequency of
20 % modulation is off by up to 7 %, with 100 by up to 2 %, in any direction, for spots of one to
three pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twinct.core.files.images import read_image
from twinct.ctsimu.scene import FocalSpot
from twinct.geometry import Floats
from twinct.xray.paths import LARGEST_TILE
from twinct.xray.spot import gaussian_spot, image_spot

SKIPPED = 20
"""Number of skipped initial points of the sequence, which lie on diagonals."""


@dataclass(frozen=True)
class Sampling:
    """Passes over the panel; the image is their mean.

    Attributes:
        spot_mm: start of each pass's rays, along u and v of the source, (passes, 2).
        shift: end of each pass's rays, in pixels from the pixel's middle along u and v,
            (passes, 2).
        samples: rays along each pixel edge in every pass.
    """

    spot_mm: Floats
    shift: Floats
    samples: int


def sampling(spot: FocalSpot, samples: int, spot_points: int, pixels: int) -> Sampling:
    """Return the passes for a focal spot.

    Args:
        spot: point, Gaussian, or image with intensity.
        samples: rays along each pixel edge, for a point; split into several passes if one would be
            too large.
        spot_points: passes for an extended spot.
        pixels: number of pixels along the longer edge of the panel.
    """
    if spot.is_point:
        divisors = [n for n in range(1, samples + 1) if samples % n == 0]
        inner = max(n for n in divisors if n == 1 or pixels * n <= LARGEST_TILE)
        steps = (np.arange(samples // inner) + 0.5) / samples - 0.5 / inner
        shift = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        return Sampling(np.zeros_like(shift), shift, inner)
    # The import takes half a second; only extended spots need it.
    from scipy.stats import qmc

    points = qmc.Halton(4, scramble=False).random(spot_points + SKIPPED)[SKIPPED:]
    # One point in each stratum of every axis.
    cube = (points.argsort(axis=0).argsort(axis=0) + 0.5) / spot_points
    inner = 2 if 2 * pixels <= LARGEST_TILE else 1
    if spot.image is not None:
        weights = read_image(spot.image, "a focal spot")
        points = image_spot(weights - min(0.0, weights.min()), *spot.size_mm, cube[:, :2])
    else:
        points = gaussian_spot(*spot.sigma_mm, cube[:, :2])
    return Sampling(points, (cube[:, 2:] - 0.5) / inner, inner)
