"""Look at the pixels of a scan while it is imported: a table of what was found, and its images."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinct.measured.air import level_of
from twinct.measured.corrections import Corrected, Corrections
from twinct.measured.lines import LineLooks

Floats = NDArray[np.float64]

BINS = 60
"""Bins of the histogram of air."""

AROUND_AIR = 0.3
"""Range of the histogram to each side of the first view's air, relative to it."""

LEAST_DRIFT = 0.01
"""Smallest change of air over the views that is named: 0.01 of a line integral."""

BEYOND_NOISE = 9.0
"""Standard errors of a view's air by which views differ: the range of 1e5 by noise alone is 8.8."""


class Drift(NamedTuple):
    """Change of air over the views: darkest and brightest view, (number, level) each.

    Attributes:
        least: the darkest.
        most: the brightest.
        error: standard error of a view's air.
        slow: True if neighbouring views are alike.
    """

    least: tuple[int, float]
    most: tuple[int, float]
    error: float
    slow: bool


_WHAT = {
    "starved": ("starved pixels", "at or below the dark noise, which is the least that counts"),
    "averaged": ("dark means", "means of dark neighbours, because one pixel is not clear of noise"),
    "bright": ("bright single pixels", "means of neighbours instead"),
    "dark": ("dark single pixels", "means of neighbours instead"),
    "saturated": ("saturated pixels", "left as they are"),
}


@dataclass(eq=False)
class Looks:
    """Counts and images of a scan, view by view.

    Attributes:
        images: images of the scan.
        scales: brightness of air by which each view was divided.
        counts: pixels of each kind in each view.
        mean: sum of the views, (rows, columns).
        least: smallest transmission of each pixel.
        most: largest transmission.
        repaired: number of views in which each pixel was repaired.
        lines: brightness of rows and of columns.
        histogram: number of pixels of air in each of ``BINS`` bins.
        edges: edges of the bins.
    """

    images: Corrections
    scales: list[float] = field(default_factory=list)
    counts: dict[str, list[int]] = field(default_factory=lambda: {kind: [] for kind in _WHAT})
    mean: Floats = field(init=False)
    least: Floats = field(init=False)
    most: Floats = field(init=False)
    repaired: NDArray[np.int64] = field(init=False)
    lines: dict[str, LineLooks] = field(default_factory=dict)
    histogram: NDArray[np.int64] = field(init=False)
    edges: Floats = field(init=False)
    _views: list[int] = field(default_factory=list)
    _air: list[float] = field(default_factory=list)
    _errors: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Start without views."""
        shape = self.images.stack.shape
        self.mean, self.repaired = np.zeros(shape), np.zeros(shape, np.int64)
        self.least, self.most = np.full(shape, np.inf), np.full(shape, -np.inf)
        if self.images.air is not None:
            views = self.images.stack.count
            for name in ("rows", "columns"):
                self.lines[name] = LineLooks(self.images.lines(name), views)
        self.histogram, self.edges = np.zeros(BINS, np.int64), np.zeros(BINS + 1)

    def add(self, view: int, corrected: Corrected) -> None:
        """Count one more view, of a number in the stack."""
        image, doubtful = corrected.image, corrected.doubtful
        self._views.append(view)
        self.scales.append(corrected.scale)
        full = corrected.saturated & ~doubtful.bright & ~self.images.bad
        for kind, found in {**doubtful._asdict(), "saturated": full}.items():
            self.counts[kind].append(int(found.sum()))
        self.repaired += doubtful.repaired
        self.mean += image
        np.minimum(self.least, image, out=self.least)
        np.maximum(self.most, image, out=self.most)
        if self.images.air is None:
            return
        for looks in self.lines.values():
            looks.add(view, image)
        air = image[self.images.air & ~self.images.bad]
        level, error = level_of(air) if air.size else (np.nan, 0.0)
        self._air.append(level)
        self._errors.append(error)
        if len(self._air) == 1:
            middle = self._air[0]
            self.edges = middle + AROUND_AIR * abs(middle) * np.linspace(-1, 1, BINS + 1)
        self.histogram += np.histogram(air, self.edges)[0]

    @property
    def air(self) -> float | None:
        """Median over the views of the mean transmission of air; None: no air is known."""
        return float(np.median(self._air)) if self._air else None

    @property
    def drift(self) -> Drift | None:
        """Change of air from view to view beyond its noise; None: there is none, or no air."""
        air = np.array(self._air)
        if len(air) < 2 or not np.isfinite(air).all():
            return None
        least, most = int(air.argmin()), int(air.argmax())
        error = float(np.median(self._errors))
        change = float(air[most] - air[least])
        if change <= max(LEAST_DRIFT * float(np.median(air)), BEYOND_NOISE * error):
            return None
        # Independent values have 2 here, a slow change 0 (von Neumann 1941).
        ratio = float(np.sum(np.diff(air) ** 2) / np.sum((air - air.mean()) ** 2))
        ends = (self._views[least], float(air[least])), (self._views[most], float(air[most]))
        return Drift(*ends, error, slow=ratio < 1)

    def share(self, kind: str) -> float:
        """Return the share of the pixels of all views that are of a kind."""
        return sum(self.counts[kind]) / (self.mean.size * max(len(self._views), 1))

    @property
    def first_saturated(self) -> int:
        """The first view with saturated pixels."""
        return next(v for v, n in zip(self._views, self.counts["saturated"], strict=True) if n)

    @property
    def table(self) -> tuple[str, ...]:
        """Lines of a table of what was found."""
        images = self.images
        if self.air is None:
            air = "unknown: no part of the panel is bright and steady in all views"
        else:
            assert images.air is not None
            air = (
                f"{self.air:.4g}, from {min(self._air):.4g} to {max(self._air):.4g} in the views, "
                f"in {images.air.mean():.0%} of the pixels"
            )
        sigma, source = images.noise
        known = f"{sigma / float(np.median(self.scales)):.3g} of air, from {source}"
        lines = [
            ("air reads", air),
            ("dark noise", known if sigma else "unknown: images.dark_noise states it"),
            *((name, self._cell(kind, done)) for kind, (name, done) in _WHAT.items()),
        ]
        return tuple(f"{name:<22}{value}" for name, value in lines)

    def _cell(self, kind: str, done: str) -> str:
        total, counts = sum(self.counts[kind]), self.counts[kind]
        if kind in ("bright", "dark") and self.images.levels is None:
            return "not looked for (images.single_pixels)"
        if not total:
            return "none"
        view = int(np.argmax(counts))
        return (
            f"{total} ({100 * self.share(kind):.2g} %), most in view {self._views[view]}: "
            f"{counts[view]}; {done}"
        )
