"""Where rays start and end: focal spot and pixel, sampled together.

A point source: each pixel is cut into equal parts, one ray to the middle of each. A focal spot:
from each of its points 2 x 2 rays a pixel, each time to other places in it, so that both averages
come from the same passes over the panel. The points are Halton's sequence in four dimensions,
ranked along each axis: with 32 of them the frequency where the modulation is 20 % is off by up to
7 %, with 100 by up to 2 %, whatever the direction, for spots of one to three pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twinct.ctsimu.scene import FocalSpot
from twinct.files.images import read_image
from twinct.geometry import Floats
from twinct.xray.paths import LARGEST_TILE
from twinct.xray.spot import gaussian_spot, image_spot

SKIPPED = 20
"""First points of the sequence, which lie on diagonals."""


@dataclass(frozen=True)
class Sampling:
    """Passes over the panel; the image is their mean.

    Attributes:
        spot_mm: where the rays of each pass start, along u and v of the source, (passes, 2).
        shift: where they end in the pixel, pixels off its middle along u and v, (passes, 2).
        samples: rays along each pixel edge in every pass.
    """

    spot_mm: Floats
    shift: Floats
    samples: int


def sampling(spot: FocalSpot, samples: int, spot_points: int, pixels: int) -> Sampling:
    """Passes for a focal spot.

    Args:
        spot: point, Gaussian, or image with intensity.
        samples: rays along each pixel edge, for a point; they are spread over several passes
            where one would be too large.
        spot_points: passes for a spot with extent.
        pixels: along the longer edge of the panel.
    """
    if spot.is_point:
        divisors = [n for n in range(1, samples + 1) if samples % n == 0]
        inner = max(n for n in divisors if n == 1 or pixels * n <= LARGEST_TILE)
        steps = (np.arange(samples // inner) + 0.5) / samples - 0.5 / inner
        shift = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        return Sampling(np.zeros_like(shift), shift, inner)
    # Half a second to import: no other work waits for it.
    from scipy.stats import qmc

    points = qmc.Halton(4, scramble=False).random(spot_points + SKIPPED)[SKIPPED:]
    # One in each of equally many strata of every axis.
    cube = (points.argsort(axis=0).argsort(axis=0) + 0.5) / spot_points
    inner = 2 if 2 * pixels <= LARGEST_TILE else 1
    if spot.image is not None:
        weights = read_image(spot.image, "a focal spot")
        points = image_spot(weights - min(0.0, weights.min()), *spot.size_mm, cube[:, :2])
    else:
        points = gaussian_spot(*spot.sigma_mm, cube[:, :2])
    return Sampling(points, (cube[:, 2:] - 0.5) / inner, inner)
