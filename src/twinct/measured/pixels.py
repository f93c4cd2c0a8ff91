"""Worth of single pixels: which of them a view does not show as the object is, and their repair.

A pixel is *single* if it differs from its six neighbours in row, column and view, while the pixels
around it do not. The optics of a detector spread every detail over neighbours: of a detail on one
pixel, a blur with a full width at half maximum of 1.1 pixels leaves a fifth on the next ones. So a
pixel that exceeds its ring ``ALONE`` times shows no detail, but a hit of the detector, or a pixel
that failed in this view. Wires, edges and balls that cover more pixels than ``MOST_TOGETHER`` are
connected, and stay; so does anything that stands out in both neighbouring views, too.

A pixel is *starved* if the mean around it is not clear of the dark image's noise. The logarithm of
a value m with the noise s is biased by s^2 / (2 m^2), and below 0 there is none. Starved pixels get
the mean of starved neighbours, as many as it takes until the mean exceeds its standard error
``CLEAR`` times (as ``recon.few_photons`` adds up photons; Hsieh, Med. Phys. 25 (1998) 2139), and no
less than this error.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

OUT = 6.0
"""Standard deviations of the noise at which a pixel differs from its neighbours."""

LEAST_OUT = 0.02
"""Smallest difference that counts, relative to the neighbours: 0.02 of a line integral."""

ALONE = 5.0
"""How many times a pixel differs more than the ring around it: a blur of 1.1 pixels leaves 5."""

STEEPER = 2.0
"""How many times more than its ring a pixel differs from its own neighbours: edges are smooth."""

RING_NOISE = 1.0
"""Standard deviations of noise by which the largest difference in a ring is lessened."""

MOST_TOGETHER = 3
"""Largest number of touching pixels that are single; a detail 2 pixels across covers 4."""

BEYOND_AIR = 1.5
"""Brightness relative to air that no object gives; phase contrast adds some tenths."""

CLEAR = 4.0
"""Standard errors of a mean below which pixels are starved: its logarithm is biased by 3 %."""

WINDOWS = (3, 5, 9)
"""Edges of the windows in which starved pixels are averaged; the smallest that is enough."""

FEWEST = 100
"""Smallest number of pixels from which noise is taken."""

MOST_NOISE = 0.05
"""Largest noise of the dark image that is believed, relative to air."""

STEPS = 14
"""Number of levels of brightness, each half the last, at which the noise is measured."""

_MEDIAN_OF_NORMAL = 0.6745


class Doubtful(NamedTuple):
    """Pixels of a view that were repaired, (rows, columns) each.

    Attributes:
        bright: single pixels, brighter than their neighbours.
        dark: single pixels, darker than their neighbours.
        starved: pixels at or below the noise of the dark image.
        averaged: pixels that hold a mean, because it is not clear of this noise.
    """

    bright: Bools
    dark: Bools
    starved: Bools
    averaged: Bools

    @property
    def repaired(self) -> Bools:
        """Pixels that another value replaces."""
        return self.bright | self.dark | self.starved | self.averaged


class ThreeViews(NamedTuple):
    """A view and its neighbours, (rows, columns) each, bad pixels filled."""

    before: Floats
    view: Floats
    after: Floats


@dataclass(frozen=True, eq=False)
class Levels:
    """Brightness of air, and noise by brightness.

    Attributes:
        air: brightest level that more than single pixels have.
        at: levels, rising.
        noise: standard deviation of a pixel's difference from its neighbours at these levels.
    """

    air: float
    at: Floats
    noise: Floats

    def noise_at(self, level: NDArray[np.floating]) -> Floats:
        """Return the standard deviation at levels of any shape."""
        return np.interp(level, self.at, self.noise)


def levels_of(views: Sequence[ThreeViews], least: float) -> Levels:
    """Return the levels of some views of a scan.

    Args:
        views: the views.
        least: noise of the dark image: images that were cut at 0 hide it.
    """
    around = [_around(three) for three in views]
    level = np.concatenate([one.ravel() for one in around])
    off = np.concatenate(
        [np.abs(three.view - one).ravel() for three, one in zip(views, around, strict=True)]
    )
    air = float(np.percentile(level, 99.9))
    which = np.clip(np.log2(air / np.maximum(level, 1e-30)), 0, STEPS).astype(int)
    at, noise = [], []
    for step in range(STEPS, -1, -1):
        if (here := which == step).sum() >= FEWEST:
            at.append(float(level[here].mean()))
            noise.append(max(float(np.median(off[here])) / _MEDIAN_OF_NORMAL, least))
    return Levels(air, np.array(at or [air]), np.array(noise or [least]))


def singles(three: ThreeViews, levels: Levels) -> tuple[Bools, Bools]:
    """Return the single bright and the single dark pixels of a view."""
    around = _around(three)
    off = three.view - around
    out = np.maximum(OUT * levels.noise_at(around), LEAST_OUT * np.abs(around))
    far = np.abs(off) > out
    if not far.any():
        return far, far
    single = far & (off > 0) & (three.view > BEYOND_AIR * levels.air)
    # From large to small differences: a hit beside an edge is alone among pixels as far off.
    for step in range(STEPS):
        large = far & ~single & (np.abs(off) > levels.air * 2.0**-step)
        if large.any():
            single |= _alone(three, around, off, large, single, levels)
    return single & (off > 0), single & (off < 0)


def _alone(
    three: ThreeViews, around: Floats, off: Floats, far: Bools, known: Bools, levels: Levels
) -> Bools:
    """Return the pixels that are far from their neighbours, while their ring is not.

    Pixels that stand out in both neighbouring views, too, are left out.

    Args:
        three: the view between its neighbours.
        around: medians of neighbours.
        off: the view less these medians.
        far: pixels that are far from their neighbours, (rows, columns).
        known: single pixels that are known; they do not count in a ring.
        levels: noise by brightness.
    """
    labels, _ = scipy.ndimage.label(far, np.ones((3, 3)))
    few = far & (np.bincount(labels.ravel()) <= MOST_TOGETHER)[labels]
    row, column = np.nonzero(few)
    level, height = around[row, column], off[row, column]
    rows, columns = far.shape
    detail, step = np.zeros(len(row)), np.zeros(len(row))
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            r, c = np.clip(row + down, 0, rows - 1), np.clip(column + right, 0, columns - 1)
            counts = ~(far[r, c] | known[r, c])
            detail = np.maximum(detail, counts * np.abs(off[r, c]))
            step = np.maximum(step, counts * np.abs(three.view[r, c] - level))
    allowed = RING_NOISE * levels.noise_at(level)
    alone = np.abs(height) > ALONE * np.maximum(detail - allowed, 0.0)
    alone &= np.abs(height) > STEEPER * np.maximum(step - allowed, 0.0)
    sign = np.sign(height)
    before, after = (sign * (one[row, column] - level) for one in (three.before, three.after))
    alone &= np.minimum(before, after) <= np.abs(height) / 2
    # Of touching pixels, all are single or none is: the end of a wire is part of the wire.
    kept = np.ones(labels.max() + 1, np.bool_)
    kept[labels[row[~alone], column[~alone]]] = False
    return few & kept[labels]


def _around(three: ThreeViews) -> Floats:
    """Return the median of the neighbours in row, column and view of each pixel."""
    edged = np.pad(three.view, 1, mode="reflect")
    s = [edged[:-2, 1:-1], edged[2:, 1:-1], edged[1:-1, :-2], edged[1:-1, 2:]]
    s += [three.before, three.after]
    for a, b in _SORTING:
        s[a], s[b] = np.minimum(s[a], s[b]), np.maximum(s[a], s[b])
    return (s[2] + s[3]) / 2


_SORTING = (
    *((0, 5), (1, 3), (2, 4), (1, 2), (3, 4), (0, 3)),
    *((2, 5), (0, 1), (2, 3), (4, 5), (1, 2), (3, 4)),
)
"""Comparisons that sort six numbers."""


def dark_noise(views: Sequence[Floats], air: float) -> float:
    """Return the noise of the dark image as values of 0 and below show it; 0 if none do.

    Where a part q of the pixels is not above 0, normal noise s has the mean a s with
    Phi(a) = 1 - q, and those above 0 have the mean s (phi(a) / Phi(a) + a). So images that were
    cut at 0 show it, too.

    Args:
        views: some views, (rows, columns).
        air: level of air.
    """
    above: list[Floats] = []
    below = 0
    for image in views:
        share = scipy.ndimage.uniform_filter((image <= 0).astype(np.float64), 3)
        # Half of the pixels here are above 0: along the edge of an opaque part, a third or less.
        mixed = (share > 0.4) & (share < 0.6)
        below += int((mixed & (image <= 0)).sum())
        above.append(image[mixed & (image > 0)])
    values = np.concatenate(above)
    if min(len(values), below) < FEWEST:
        return 0.0
    a = float(scipy.special.ndtri(len(values) / (len(values) + below)))
    density = np.exp(-(a**2) / 2) / np.sqrt(2 * np.pi)
    noise = float(values.mean()) / (density / float(scipy.special.ndtr(a)) + a)
    return noise if noise < MOST_NOISE * air else 0.0


def starved(image: Floats, noise: float) -> tuple[Floats, Bools, Bools]:
    """Return a view with means in place of starved pixels, which are starved, and which are means.

    Args:
        image: transmissions, (rows, columns).
        noise: standard deviation of the dark image, as a transmission; 0: none is starved.
    """
    if not noise or not (image < CLEAR * noise).any():
        none = np.zeros(image.shape, np.bool_)
        return image, none, none
    mean = scipy.ndimage.uniform_filter(image, 3)
    rest, own = mean < CLEAR * noise, image <= noise
    averaged = rest.copy()
    result = np.where(own, noise, image)
    in_window, sums = _sums(averaged.astype(np.float64)), _sums(np.where(averaged, image, 0.0))
    # The widest window decides: narrow ones would stop where the noise happens to be high.
    widest = sums(WINDOWS[-1]) / np.maximum(in_window(WINDOWS[-1]), 1.0)
    for width in WINDOWS:
        pixels = np.maximum(in_window(width), 1.0)
        error = noise / np.sqrt(pixels)
        result[rest] = np.maximum(sums(width) / pixels, error)[rest]
        rest &= widest < CLEAR * error
    return result, own, averaged


def _sums(image: Floats) -> Callable[[int], Floats]:
    """Return a function that gives the sum of an image in the window of each pixel."""
    return lambda width: scipy.ndimage.uniform_filter(image, width, mode="constant") * width**2
