"""Rows and columns of the panel that differ from the others, as their air shows.

Beside the object, each row has air whose brightness is that of the row in this view. A row differs
in all views, as one of another gain, or a tile of the panel that the flats miss; or in some, if its
readout flickers. The same holds for columns with air above or below the object.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

Floats = NDArray[np.floating]
Bools = NDArray[np.bool_]

FEWEST = 8
"""Smallest number of pixels of air that tell the brightness of a line."""

MOST = 64
"""Largest number of pixels in a line that are read, spread over its air."""

BESIDE = 3
"""Pixels beside the object that do not count as air of a line."""

PARTS = 4
"""Parts of a line, one after the other: a line differs in all, an object that shades it in some."""

ALIKE = 0.25
"""Smallest difference in a part, relative to that of the line, that shows the line to differ: at 4
standard errors noise leaves half."""

SPREAD = 1.1
"""Standard error of the mean of the inner half of normal values, relative to that of all."""

CLEAR = 6.0
"""Standard errors by which a line differs: of 1e8 lines in all views, noise gives 0.2."""

EVENED = 4.0
"""Standard errors by which a line differs that is evened: of 1e4 lines, noise gives 0.6."""

FINE = 0.001
"""Smallest difference that is evened: images without noise have no error to compare it with."""

APART = 3
"""Distance of lines that are compared at a seam: means of 3 lines on either side do not overlap."""

SEAM = 0.1
"""Smallest share of the pixels along a seam that must be steady."""

WHOLE = 0.7
"""Smallest share of all lit pixels along a seam that step alike: edges of objects end somewhere."""

LEAST = 0.01
"""Smallest difference of a line that is named: 0.01 of a line integral."""

WIDTH = 9
"""Lines of the median from which one line differs."""

TILE_OFF = 0.2
"""Largest step at a seam between tiles: more is an object's edge."""

MOST_KEPT = 2e7
"""Largest number of values that are kept to look for lines: 80 MB."""


@dataclass(frozen=True, eq=False)
class AirOfLines:
    """Pixels of air in each row, or in each column.

    A line that differs counts as air where most of its neighbours are.

    Attributes:
        air: pixels that show air, (rows, columns).
        along: ``rows`` or ``columns``.
    """

    air: Bools
    along: str

    @cached_property
    def _pixels(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Places of some air in each line, and their number; 0 where there are too few."""
        air = self.air if self.along == "rows" else self.air.T
        near = scipy.ndimage.uniform_filter1d(air.astype(np.float32), WIDTH, axis=0)
        # The edge of the object may shade the pixels next to it in some views.
        air = scipy.ndimage.minimum_filter(near > 0.5, 2 * BESIDE + 1, mode="nearest")
        counts = air.sum(axis=1)
        counts[counts < FEWEST] = 0
        share = (np.arange(MOST) + 0.5) / MOST
        rank = np.minimum((share * counts[:, None]).astype(int), np.maximum(counts - 1, 0)[:, None])
        starts = np.concatenate([[0], np.cumsum(air.sum(axis=1))[:-1]])
        places = np.nonzero(air)[1] if air.any() else np.zeros(1, np.intp)
        return places[np.minimum(starts[:, None] + rank, len(places) - 1)], np.minimum(counts, MOST)

    def brightness(self, image: Floats) -> tuple[Floats, Floats]:
        """Return the air of each line of a view relative to all, and its standard error.

        Where too little air is known, they are 1 and infinite; where parts of a line contradict
        each other, it is 1.
        """
        places, counts = self._pixels
        lines = image if self.along == "rows" else image.T
        values = np.take_along_axis(lines, places, axis=1)
        off = np.abs(np.diff(values, axis=1))[np.diff(places, axis=1) > 0]
        values = values.reshape(len(lines), PARTS, -1)
        quarter = MOST // PARTS // 4
        inner = np.sort(values, axis=2)[:, :, quarter:-quarter]
        known = counts > 0
        if not known.any():
            return np.ones(len(counts)), np.full(len(counts), np.inf)
        means = inner.mean(axis=2)
        level = float(np.median(means[known]))
        noise = 1.4826 * float(np.median(off)) / np.sqrt(2)
        error = SPREAD * noise / level / np.sqrt(np.maximum(counts, 1))
        air, parts = means.mean(axis=1) / level, means / level - 1
        all_alike = ((air - 1)[:, None] * parts > ALIKE * (air - 1)[:, None] ** 2).all(axis=1)
        return np.where(known & all_alike, air, 1.0), np.where(known, error, np.inf)

    def evened(self, image: NDArray[np.float64], kind: str) -> NDArray[np.float64]:
        """Return a view whose lines are as bright as the others, where they clearly differ.

        Args:
            image: transmission, (rows, columns).
            kind: ``gain`` to divide by a line's brightness, ``offset`` to subtract the difference.
        """
        air, error = self.brightness(image)
        wrong = np.abs(air - 1) > np.maximum(EVENED * error, FINE)
        if not wrong.any():
            return image
        one = np.where(wrong, air, 1.0)
        one = one[:, None] if self.along == "rows" else one[None, :]
        return image / one if kind == "gain" else image - (one - 1) * self._level(image)

    def _level(self, image: Floats) -> float:
        return float(np.median(image[self.air]))


class OddLines(NamedTuple):
    """Lines that differ.

    Attributes:
        always: lines that differ in all views, and by how much.
        flickers: number of lines of single views that differ.
        worst: (view, line, difference) of the largest of them.
    """

    always: tuple[tuple[int, float], ...] = ()
    flickers: int = 0
    worst: tuple[int, int, float] = (0, 0, 0.0)


@dataclass(eq=False)
class LineLooks:
    """Brightness of rows, or columns, view by view.

    Attributes:
        lines: their pixels.
        views: number of views that will be added.
    """

    lines: AirOfLines
    views: int
    _numbers: list[int] = field(default_factory=list)
    _kept: list[NDArray[np.float32]] = field(default_factory=list)
    _errors: list[Floats] = field(default_factory=list)
    _seen: int = 0

    def add(self, view: int, image: Floats) -> None:
        """Count one more view, of a number in the stack."""
        every = int(np.ceil(self.views * len(image) / MOST_KEPT))
        self._seen += 1
        if (self._seen - 1) % every:
            return
        air, error = self.lines.brightness(image)
        self._numbers.append(view)
        self._kept.append(air.astype(np.float32))
        self._errors = [error] if not self._errors else [(self._errors[0] + error) / 2]

    @property
    def odd(self) -> OddLines:
        """Lines that differ from the others."""
        if len(self._kept) < 2 or not np.isfinite(self._errors[0]).any():
            return OddLines()
        air, error = np.array(self._kept), self._errors[0]
        usual = np.median(air, axis=0)
        known = np.isfinite(error)
        fixed = np.where(known, CLEAR * error / np.sqrt(len(air)), np.inf)
        beside = _beside(usual, known)
        always = np.abs(beside) > np.maximum(fixed, LEAST)
        off = np.array([_beside(one, known) for one in air - usual])
        flickers = np.abs(off) > np.where(known, np.maximum(CLEAR * error, LEAST), np.inf)
        view, line = np.unravel_index(int(np.where(flickers, np.abs(off), 0).argmax()), off.shape)
        return OddLines(
            tuple((int(n), float(beside[n])) for n in always.nonzero()[0]),
            int(flickers.sum()),
            (self._numbers[view], int(line), float(off[view, line])),
        )


def _beside(values: Floats, known: Bools) -> Floats:
    """Return the difference of each line from the median of its neighbours."""
    return np.where(known, values - scipy.ndimage.median_filter(values, WIDTH, mode="nearest"), 0.0)


def seams(mean: Floats, steady: Bools, along: str) -> tuple[tuple[int, float], ...]:
    """Return the lines at which a tile of the panel begins, and the step of brightness there.

    Args:
        mean: mean of some views, smooth over 3 x 3 pixels, (rows, columns).
        steady: pixels that do not change from view to view.
        along: ``rows`` or ``columns``.
    """
    if along == "columns":
        mean, steady = mean.T, steady.T
    if len(mean) <= APART:
        return ()
    both = steady[APART:] & steady[:-APART] & (mean[APART:] > 0) & (mean[:-APART] > 0)
    ratio = np.full(both.shape, np.nan)
    ratio[both] = mean[APART:][both] / mean[:-APART][both] - 1
    enough = both.sum(axis=1) >= max(FEWEST, SEAM * both.shape[1])
    steps = np.zeros(len(both))
    for line in enough.nonzero()[0]:
        steps[line] = np.median(ratio[line][both[line]])
    noise = 1.4826 * float(np.median(np.abs(steps[enough]))) if enough.any() else 0.0
    far = (np.abs(steps) > max(LEAST, CLEAR * noise)) & (np.abs(steps) < TILE_OFF)
    labels, count = scipy.ndimage.label(far)
    found = []
    for label in range(1, count + 1):
        at = (labels == label).nonzero()[0]
        largest = int(at[np.abs(steps[at]).argmax()])
        if len(at) <= APART + 1 and _whole(mean, largest, float(steps[largest])):
            found.append((largest + APART // 2 + 1, float(steps[largest])))
    return tuple(found)


def _whole(mean: Floats, line: int, step: float) -> bool:
    """Return True if a step is along all of a line."""
    p = np.log(np.maximum(mean, 1e-6))
    change = p[APART:] - p[:-APART]
    around = [change[at] for at in (line - WIDTH // 2, line + WIDTH // 2) if 0 <= at < len(change)]
    own = change[line] - (np.mean(around, axis=0) if around else 0.0)
    own = scipy.ndimage.median_filter(own, WIDTH, mode="nearest")
    return bool((np.abs(own - np.log1p(step)) < abs(step) / 2).mean() >= WHOLE)
