"""Noise of a detector, as its dark and flat images show it, or the views themselves.

The difference of two flat images shows nothing but noise. Its variance is that of a pixel. Where
the detector's blur spreads the signal of a photon over neighbours, these share their noise: a pixel
has less of it than its photons give, and the mean of many pixels has what photons give. The sum of
the autocovariance of the difference tells this variance: it is the noise power at frequency 0, by
which IEC 62220-1 counts the photons of a detector (see also Moore, Ninkov and Forrest, Opt. Eng. 45
(2006) 076402).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinct.measured.description import FieldImages, Images
from twinct.measured.pixels import dark_noise
from twinct.measured.stack import open_stack

Floats = NDArray[np.float64]

ROUNDING = 12**-0.5
"""Standard deviation of the error of rounding to whole numbers."""

MOST_PAIRS = 8
"""Largest number of pairs of flat images that are compared: each has thousands of pixels."""

REACH = 4
"""Pixels over which noise is correlated: a blur of sigma 1 leaves 0.3 % of the sum beyond."""

BEYOND = 8
"""Pixels up to which what correlates beyond ``REACH`` is taken for slow changes of the beam."""

OUTLYING = 6.0
"""Robust standard deviations beyond which a difference is a hit of the detector, not noise."""

LIT = 0.1
"""Smallest brightness of a flat pixel that counts, relative to the median."""

FEWEST = 10_000
"""Smallest number of pixels, of all pairs: the sum of their covariances is known to 13 %."""

_MEDIAN_OF_NORMAL = 0.6745


class DarkNoise(NamedTuple):
    """Noise of the dark image.

    Attributes:
        sigma: standard deviation, as a transmission; 0: unknown.
        source: where it is from, for messages.
    """

    sigma: float
    source: str


class FlatNoise(NamedTuple):
    """Noise of the free beam, of a pixel that is as bright as the median.

    Attributes:
        snr: signal-to-noise ratio of a pixel.
        gain: standard deviation of a pixel relative to what it would be if neighbours did not share
            their noise.
        pairs: number of pairs of flat images.
    """

    snr: float
    gain: float
    pairs: int

    def at(self, brightness: float) -> FlatNoise:
        """Return the noise of views whose air is so many times as bright as the flats."""
        return self._replace(snr=self.snr * brightness**0.5)

    @property
    def section(self) -> dict[str, Any]:
        """The section ``detector.noise`` that states this noise."""
        return {"kind": "snr", "snr": float(f"{self.snr:.4g}"), "gain": float(f"{self.gain:.4g}")}


def noise_of_dark(
    section: Images, dtype: np.dtype[Any], unit: float, images: Sequence[Floats], air: float
) -> DarkNoise:
    """Return the noise of the dark image: stated, from darks, from the views, or of rounding.

    Args:
        section: the section ``images``.
        dtype: number type of the views.
        unit: the transmission that a stored number of 1 is.
        images: some views as transmissions, (rows, columns).
        air: their brightness in air.
    """
    if section.values == "line_integrals":
        return DarkNoise(0.0, "unknown")
    if section.dark_noise is not None:
        return DarkNoise(section.dark_noise * unit, "images.dark_noise")
    rounding = unit * ROUNDING if np.issubdtype(dtype, np.integer) else 0.0
    if noise := _of_darks(section.darks):
        return DarkNoise(max(noise * unit, rounding), "images.darks")
    if noise := dark_noise(images, air):
        return DarkNoise(max(noise, rounding), "values of 0 and below")
    return DarkNoise(rounding, "rounding to whole numbers" if rounding else "unknown")


def _of_darks(sections: tuple[FieldImages, ...]) -> float:
    """Return the standard deviation of two dark images' difference, per image; 0 without two."""
    for index, section in enumerate(sections):
        stack = open_stack(section, f"images.darks.{index}")
        if stack.count > 1:
            change = np.abs(stack.image(1).astype(np.float64) - stack.image(0))
            return float(np.median(change)) / _MEDIAN_OF_NORMAL / np.sqrt(2)
    return 0.0


def noise_of_flats(
    section: Images,
    dark: Callable[[int], Floats | float],
    placed: Callable[[Floats], NDArray[np.floating]],
) -> FlatNoise | None:
    """Return the noise of the free beam as pairs of flat images show it.

    Args:
        section: the section ``images``.
        dark: returns the dark image of a view.
        placed: brings a stored image onto the panel of the scan, where pixels may be averages.

    Returns:
        None without two flat images, if they are equal, or of too few pixels.
    """
    found = [_of_pair(*map(placed, pair)) for pair in _pairs(section, dark)]
    if sum(one.pixels for one in found) < FEWEST:
        return None
    single, together, _ = np.average(found, axis=0, weights=[one.pixels for one in found])
    if not (single > 0 and together > 0):
        return None
    return FlatNoise(float(single**-0.5), float((single / together) ** 0.5), len(found))


def _pairs(
    section: Images, dark: Callable[[int], Floats | float]
) -> Iterator[tuple[Floats, Floats]]:
    """Yield pairs of flat images without their dark part, each image once."""
    left = MOST_PAIRS
    for index, flat in enumerate(section.flats):
        stack = open_stack(flat, f"images.flats.{index}")
        offset = dark(round(flat.view or 0))
        for first in range(0, stack.count - 1, 2):
            if not left:
                return
            left -= 1
            one, other = (stack.image(first + i).astype(np.float64) - offset for i in (0, 1))
            yield one, other


class _Variance(NamedTuple):
    """Relative variance of a pixel as bright as the median: alone, and as one of many together.

    The second is the variance of the sum of many pixels, divided by their number.
    """

    single: float
    together: float
    pixels: int


def _of_pair(one: NDArray[np.floating], other: NDArray[np.floating]) -> _Variance:
    levels = [float(np.median(image)) for image in (one, other)]
    if min(levels) <= 0:
        return _Variance(0.0, 0.0, 0)
    a, b = one / levels[0], other / levels[1]
    mean = (a + b) / 2
    counts = np.isfinite(mean) & (mean > LIT)
    # Noise of photons: the variance is proportional to the brightness.
    off = np.where(counts, (a - b) / np.sqrt(2 * np.where(counts, mean, 1.0)), 0.0)
    sigma = float(np.median(np.abs(off[counts]))) / _MEDIAN_OF_NORMAL if counts.any() else 0.0
    counts &= np.abs(off) < OUTLYING * sigma
    if not counts.any():
        return _Variance(0.0, 0.0, 0)
    off = np.where(counts, off - off[counts].mean(), 0.0)
    near, far = [], []
    rows, columns = (min(BEYOND, length - 1) for length in off.shape)
    for down in range(-rows, rows + 1):
        for right in range(-columns, columns + 1):
            within = max(abs(down), abs(right)) <= REACH
            (near if within else far).append(_covariance(off, counts, down, right))
    slow = float(np.mean(far)) if far else 0.0
    single = _covariance(off, counts, 0, 0) - slow
    return _Variance(single, float(np.sum(near)) - len(near) * slow, int(counts.sum()))


def _covariance(off: Floats, counts: NDArray[np.bool_], down: int, right: int) -> float:
    """Return the mean product of pixels and those a number of rows and columns away."""
    (here, there), (left, beside) = _overlap(off.shape[0], down), _overlap(off.shape[1], right)
    pairs = int((counts[here, left] & counts[there, beside]).sum())
    return float((off[here, left] * off[there, beside]).sum()) / max(pairs, 1)


def _overlap(length: int, by: int) -> tuple[slice, slice]:
    """Return the parts of an axis that meet when one is moved."""
    return slice(max(-by, 0), length - max(by, 0)), slice(max(by, 0), length + min(by, 0))
