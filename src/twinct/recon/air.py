"""Noise of line integrals, from the number of photons or from the air beside the object.

Of N photons in the free beam, a line integral of 0 has a variance of 1 / N. Where N is unknown, air
shows it: its line integral is zero in every view, so that its scatter is noise, whatever the
object. Photon statistics give the noise elsewhere: the variance of a line integral p is exp(p)
times that of air.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.recon.checks import Mask, mask_of, masked_image

MOST_VIEWS = 32
"""Number of views, spread over the scan, from which the noise is taken."""

MOST_PIXELS = 2**12
"""Number of pixels of a view, spread over it."""

FEWEST_PIXELS = 200
"""Smallest number of pixels in air."""

CLEAR = 0.02
"""Largest line integral of air, less its noise: 2 % of the photons are absorbed."""

DARKEST = 8.0
"""Line integral up to which photon statistics are believed: beyond, other noise is larger."""

LEAST = 1e-3
"""Smallest noise of line integrals in air that counts, that of 1e6 photons."""

_MEDIAN_OF_NORMAL = 0.6745
"""Median of the absolute value of a standard normal variable."""


@dataclass(frozen=True, eq=False)
class KnownNoise:
    """Standard deviation of the line integrals in the free beam.

    Attributes:
        in_air: by view, (views,).
        source: the number of photons, or air in the projections.
    """

    in_air: NDArray[np.float64]
    source: Literal["photons", "air"]

    @property
    def photons(self) -> NDArray[np.float64]:
        """Number of photons of a pixel that have this noise, (views,)."""
        return self.in_air**-2.0


def noise_in_air(
    p: NDArray[Any], mask: Mask | None, photons: NDArray[np.float64] | None
) -> KnownNoise | None:
    """Return the noise of the photons, or without them of air; None if there is no air.

    Args:
        p: line integrals, (views, rows, columns).
        mask: as in ``air_noise``.
        photons: photons of a pixel in the free beam, (views,).
    """
    if photons is not None:
        return KnownNoise(photons**-0.5, "photons")
    noise = air_noise(p, mask)
    return None if noise is None else KnownNoise(np.full(len(p), noise), "air")


def known_noise(
    p: NDArray[Any], mask: Mask | None, photons: NDArray[np.float64] | None
) -> KnownNoise | None:
    """Return what ``noise_in_air`` does; None also if air shows no noise."""
    noise = noise_in_air(p, mask, photons)
    return noise if photons is not None or (noise and noise.in_air[0] >= LEAST) else None


def air_noise(p: NDArray[Any], mask: Mask | None) -> float | None:
    """Estimate the standard deviation of a line integral in air, from a scan with air in it.

    Second differences along rows and columns remove what is smooth (Immerkaer 1996); their median
    is robust against edges.

    Args:
        p: line integrals, (views, rows, columns).
        mask: True where a pixel counts, (rows, columns) or (views, rows, columns).

    Returns:
        None if the views show too little air.
    """
    differences: list[NDArray[Any]] = []
    means: list[NDArray[Any]] = []
    step = int(np.ceil(np.sqrt(p[0].size / MOST_PIXELS)))
    for view in range(0, len(p), -(-len(p) // MOST_VIEWS)):
        image = masked_image(p, view, mask)
        rough = image
        for axis in range(2):
            rough = scipy.ndimage.correlate1d(rough, [1.0, -2.0, 1.0], axis)
        mean = scipy.ndimage.uniform_filter(image, 3)
        counts = np.zeros(image.shape, np.bool_)
        counts[1:-1:step, 1:-1:step] = True
        if mask is not None:
            counts &= scipy.ndimage.minimum_filter(mask_of(mask, view), 3)
        differences.append(np.abs(rough[counts]) / 6)
        means.append(mean[counts])
    rough, mean = np.concatenate(differences), np.concatenate(means)
    if not mean.size:
        return None
    everywhere = deviation_of(rough * np.exp(-np.clip(mean, 0, DARKEST) / 2))
    air = rough[np.abs(mean) < max(CLEAR, everywhere)]
    return deviation_of(air) if air.size >= FEWEST_PIXELS else None


def deviation_of(sizes: NDArray[Any]) -> float:
    """Return the standard deviation of normal noise from absolute values, by their median."""
    return float(np.median(sizes)) / _MEDIAN_OF_NORMAL
