"""Line integrals of pixels that few photons reach.

The logarithm of a Poisson number n with mean m is biased: -ln n exceeds -ln m by 1 / (2 m) on
average, and an empty pixel has no logarithm at all. -ln(n + 1/2) is unbiased to the first order
(Anscombe, Biometrika 35 (1948) 246; Haldane, Ann. Hum. Genet. 20 (1956) 309), which is good down to
two or three photons. Below, photons of neighbouring pixels that are as dark are added up before the
logarithm, as many as it takes: their mean is unbiased, the mean of their logarithms is not.
"""

from __future__ import annotations

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from twinct.core.errors import InputError
from twinct.recon.checks import Checks
from twinct.recon.engine import Singles

STARVED = 4.0
"""Mean number of photons in 3 x 3 pixels below which they are added up."""

EMPTY = 0.505
"""Photons up to which a pixel is empty: such pixels are stored as half a photon, rounded."""

ENOUGH = 12.0
"""Number of photons that is enough."""

WINDOWS = (3, 5, 9, 17)
"""Edges of the windows in which photons are added up, in pixels; the smallest that is enough."""


def integrals_of_photons(transmission: ArrayLike, photons: ArrayLike) -> Singles:
    """Return line integrals, -ln(I/I0), whose mean few photons do not bias.

    Args:
        transmission: I/I0, (views, rows, columns); as small as half a photon or less is empty.
        photons: photons of a pixel in the free beam, one number or one for each view, (views,).
            Where noise of neighbours is correlated: the number that has the noise of a pixel.

    Returns:
        (views, rows, columns), float32.

    Raises:
        InputError: the images are no stack, or a number of photons is not positive and finite.
    """
    images = np.asarray(transmission, dtype=np.float32)
    if images.ndim != 3:
        raise InputError(
            f"transmission has {images.ndim} axes; it must have views, rows and columns"
        )
    checks = Checks(images.shape)
    numbers = checks.photons(photons)
    checks.done()
    assert numbers is not None
    integrals = np.empty_like(images)
    for image, number, out in zip(images, numbers, integrals, strict=True):
        counts = image * number
        counts[counts <= EMPTY] = 0.0
        starved = scipy.ndimage.uniform_filter(counts, 3) < STARVED
        rays = np.full(counts.shape, number)
        if starved.any():
            counts, rays = _added_up(counts, starved, number)
        out[:] = -np.log((counts + 0.5) / rays)
    return integrals


def _added_up(
    counts: NDArray[np.float64], starved: NDArray[np.bool_], number: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the photons of starved pixels and of neighbours, and their number in the free beam.

    The widest window decides which one is wide enough: each by its own photons would stop at those
    that happen to have many.
    """

    def in_window(image: NDArray[np.float64], width: int) -> NDArray[np.float64]:
        return scipy.ndimage.uniform_filter(image, width, mode="constant") * width**2

    dark = starved.astype(np.float64)
    own = counts * dark
    mean = in_window(own, WINDOWS[-1]) / np.maximum(in_window(dark, WINDOWS[-1]), 1.0)
    total, rays = counts.copy(), np.full(counts.shape, number)
    rest = starved.copy()
    for width in WINDOWS:
        pixels = in_window(dark, width)
        total[rest], rays[rest] = in_window(own, width)[rest], number * pixels[rest]
        rest &= mean * pixels < ENOUGH
    return total, rays
