"""Air beside the object: pixels that are bright and steady in all views."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

Floats = NDArray[np.floating]
Bools = NDArray[np.bool_]

ALIKE = 0.02
"""Largest relative distance of a pixel in air from the level of air."""

STEADY = 0.01
"""Largest change from view to view, relative to air, that is not noise."""

AS_NOISE = 2.0
"""How many times more than from pixel to pixel air changes from view to view, at most."""

LEAST = 0.005
"""Smallest share of the pixels of an image that tells the level of air."""

ROUNDS = 5
"""Rounds in which the level follows the pixels near it: it changes by less than 0.1 % after."""


SHADED = 4.0
"""Robust standard deviations from the median of air beyond which a pixel of a view is shaded."""

NEAR_ONE = 0.05
"""Largest distance from 1 of air whose flats have the exposure of the views."""

BRIGHTER = 0.1
"""Brightness beyond air that no object gives: phase contrast does so at single pixels only."""

BEYOND = 6.0
"""Standard deviations of noise by which a pixel is brighter than air."""

LEAST_FALL = 0.01
"""Smallest fall-off over a panel that is looked at: less makes line integrals wrong by 0.01."""

SURE = 3.0
"""Standard errors by which air follows the beam rather than not."""


class FoundAir(NamedTuple):
    """Air in some views.

    Attributes:
        pixels: those that show air in all views, (rows, columns); None: there are none.
        falls: True if air falls off as the beam does.
        brighter: what is brighter than air; None: nothing is, or no air near 1 is known.
        mean: mean of the views, scaled to each other and smooth over 3 x 3 pixels.
        steady: pixels that do not change from view to view, air or not.
    """

    pixels: Bools | None
    falls: bool
    brighter: Brighter | None = None
    mean: Floats = np.zeros((0, 0))
    steady: Bools = np.zeros((0, 0), np.bool_)


class Brighter(NamedTuple):
    """Pixels that are brighter than air, as those of flats that hold an object.

    Attributes:
        share: part of the pixels, in the view with the most.
        view: this view, by its place among the views.
    """

    share: float
    view: int


def found_air(
    views: Sequence[Floats], beams: Sequence[Floats], falls: bool | None = None
) -> FoundAir:
    """Return the air in some views, and whether it falls off with the free beam.

    Divided by the beam or left as it is: the pixels alike and steady are more numerous in the way
    that is right. There the logarithm of air is compared with that of the beam. Air of right flats
    has slope 0, air of flats without the fall-off has slope 1.

    Args:
        views: some views, each (rows, columns).
        beams: relative brightness of the free beam in these views.
        falls: known to fall off, or not to; None: see what the views show.
    """
    if len(views) < 2:
        return FoundAir(None, bool(falls), None)
    smooth = [
        scipy.ndimage.median_filter(view.astype(np.float32), 3, mode="nearest") for view in views
    ]
    even = [view / beam for view, beam in zip(smooth, beams, strict=True)]
    if falls is None and min(float(beam.min()) for beam in beams) > 1 - LEAST_FALL:
        falls = False
    if falls is None:
        as_is, divided = _air_of(smooth), _air_of(even)
        sizes = [0 if pixels is None else int(pixels.sum()) for pixels in (as_is, divided)]
        most = divided if sizes[1] > sizes[0] else as_is
        falls = most is not None and _follows(smooth, beams, most)
        pixels = divided if falls else as_is
    else:
        pixels = _air_of(even if falls else smooth)
    return FoundAir(pixels, falls, *_steady(even if falls else smooth))


def level_of(air: Floats) -> tuple[float, float]:
    """Return the mean of the air in a view without shaded pixels, and its standard error."""
    middle = float(np.median(air))
    off = np.abs(air - middle)
    clear = air[off <= max(SHADED * 1.4826 * float(np.median(off)), ALIKE * abs(middle))]
    # Blur over three pixels leaves a ninth of them independent.
    return float(clear.mean()), 3 * float(clear.std()) / np.sqrt(clear.size)


def _steady(views: Sequence[Floats]) -> tuple[Brighter | None, Floats, Bools]:
    """Return what is brighter than air near 1, the mean of the views, and the steady pixels.

    The views are divided by their median ratio to the mean view: half of the panel may change.
    """
    mean = np.mean(views, axis=0)
    lit = mean > ALIKE
    if lit.mean() < LEAST:
        return None, mean, np.zeros(mean.shape, np.bool_)
    even = [view / max(float(np.median(view[lit] / mean[lit])), ALIKE) for view in views]
    rough = _rough(even[0], lit & (mean > 0.5 * np.percentile(mean, 99.5)))
    steady = lit & (np.std(even, axis=0) < np.maximum(STEADY * mean, AS_NOISE * rough))
    limit = 1 + max(BRIGHTER, BEYOND * rough)
    shares = [float((one > limit).mean()) for one in even]
    most = int(np.argmax(shares))
    known = (steady & (np.abs(mean - 1) < NEAR_ONE)).mean() >= LEAST
    brighter = Brighter(shares[most], most) if known and shares[most] > LEAST else None
    return brighter, mean, steady


def _rough(view: Floats, where: Bools) -> float:
    """Return the median difference of pixels 3 rows apart: there, medians of 3 x 3 are independent.

    0 without such pixels.
    """
    off = np.abs(view[3:] - view[:-3])[where[3:] & where[:-3]]
    return float(np.median(off)) if off.size else 0.0


def _follows(views: Sequence[Floats], beams: Sequence[Floats], air: Bools) -> bool:
    """Return True if air follows the beam's fall-off more than halfway."""
    beam = np.log(np.mean([one[air] for one in beams], axis=0))
    level = np.log(np.mean([one[air] / np.median(one[air]) for one in views], axis=0))
    off = beam - beam.mean()
    spread = float((off**2).sum())
    if not spread > 0:
        return False
    slope = float((off * level).sum()) / spread
    rest = level - level.mean() - slope * off
    # Medians of 3 x 3 pixels: a ninth of them is independent.
    error = 3 * float(np.sqrt((rest**2).mean() / spread))
    return slope - SURE * error > 0.5


def _air_of(smooth: Sequence[Floats]) -> Bools | None:
    """Return the pixels that show air in all of some views, (rows, columns); None without any.

    The views are divided by their brightest parts, because the tube may drift. Whatever the object
    ever shades is darker on average, or changes from view to view.
    """
    tops = [float(np.percentile(view, 99.5)) for view in smooth]
    if min(tops) <= 0:
        return None
    scaled = [view / top for view, top in zip(smooth, tops, strict=True)]
    mean = np.mean(scaled, axis=0)
    change = np.std(scaled, axis=0)
    level = float(np.percentile(mean, 99.5))
    near = np.abs(mean - level) < ALIKE * level
    for _ in range(ROUNDS):
        level = float(np.median(mean[near]))
        near = np.abs(mean - level) < ALIKE * level
    most = max(STEADY * level, AS_NOISE * _rough(scaled[0], near))
    air = near & (change < most)
    return air if air.mean() >= max(LEAST, near.mean() / 2) else None
