"""Figures of a volume without a truth: residuals, noise between halves, width of its own edges."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.evaluation import edges_of, region_of_interest
from twinct.geometry import ScanGeometry
from twinct.recon import Projector
from twinct.recon.volume import Volume

Bools = NDArray[np.bool_]
Singles = NDArray[np.float32]


@dataclass(frozen=True)
class Judgement:
    """Figures of a volume without a truth.

    Attributes:
        residual: root mean square of p - A x over the rays through the grid.
        residual_rel: the same, relative to that of p.
        residual_by_view: the same of each view, relative to that of p of all views, (views,).
        edge_width_mm: median 10-90 % rise across the surface at Otsu's threshold (Otsu 1979); NaN
            without such a surface in the region that every view sees.
        noise_per_mm: standard deviation of the noise, from two volumes of every other view; NaN if
            they were not made.
        consistency_rel: residual of each half of the views predicted by the volume of the other
            half, relative to p; NaN if these volumes were not made.
        further: figures of kinds that need no truth, by name, nested as in ``metrics.json``.
    """

    residual: float
    residual_rel: float
    residual_by_view: tuple[float, ...]
    edge_width_mm: float
    noise_per_mm: float = math.nan
    consistency_rel: float = math.nan
    further: Mapping[str, Any] = field(default_factory=dict[str, Any])

    def as_dict(self) -> dict[str, Any]:
        """Return the figures by name."""
        data = {name: value for name, value in vars(self).items() if name != "further"}
        return data | dict(self.further)

    @classmethod
    def of(cls, data: Mapping[str, Any]) -> Judgement:
        """Restore figures from the output of ``as_dict``."""
        own = {one.name for one in fields(cls)} - {"further"}
        further = {name: value for name, value in data.items() if name not in own}
        named = {name: value for name, value in data.items() if name in own}
        named["residual_by_view"] = tuple(named["residual_by_view"])
        return cls(**named, further=further)

    def with_halves_of(self, before: Judgement) -> Judgement:
        """Return the figures with those of halves that were made before."""
        of_halves = {key: getattr(before, key) for key in ("noise_per_mm", "consistency_rel")}
        return replace(self, **of_halves)

    def in_words(self, _: str) -> str:
        """Return the main figures in words; they are relative to no material."""
        words = f"residual {100 * self.residual_rel:.2f} %, edges {self.edge_width_mm:.3f} mm wide"
        if math.isfinite(self.noise_per_mm):
            words += f", noise {self.noise_per_mm:.5f}/mm"
        if math.isfinite(self.consistency_rel):
            words += f", consistency {100 * self.consistency_rel:.2f} %"
        return words


def judge_volume(
    volume: Volume,
    geometry: ScanGeometry,
    line_integrals: Singles,
    bad: Bools | None = None,
    halves: tuple[Volume, Volume] | None = None,
) -> Judgement:
    """Return the figures of a volume.

    Args:
        volume: the volume, 1/mm.
        geometry: geometry that it was reconstructed from.
        line_integrals: p, (views, rows, columns).
        bad: bad pixels, (rows, columns), which do not count.
        halves: volumes of the even and of the odd views, by the same algorithm.
    """
    squares, rays, whole = _squares(volume, geometry, line_integrals, bad)
    residual = math.sqrt(float(squares.sum() / rays.sum()))
    region = region_of_interest(geometry, volume.grid)
    noise = consistency = math.nan
    if halves is not None:
        if region.any():
            # The difference has the noise of each half twice; the whole has half that of a half.
            noise = float(np.std((halves[0].array - halves[1].array)[region])) / 2
        off = seen = 0.0
        for half, other in zip(halves, (1, 0), strict=True):
            held = _squares(half, geometry[other::2], line_integrals[other::2], bad)
            off, seen = off + float(held[0].sum()), seen + int(held[1].sum())
        consistency = math.sqrt(off / seen) / whole
    return Judgement(
        residual=residual,
        residual_rel=residual / whole,
        residual_by_view=tuple((np.sqrt(squares / rays) / whole).tolist()),
        edge_width_mm=_edge_width(volume, region),
        noise_per_mm=noise,
        consistency_rel=consistency,
    )


def _squares(
    volume: Volume, geometry: ScanGeometry, line_integrals: Singles, bad: Bools | None
) -> tuple[NDArray[np.float64], NDArray[np.intp], float]:
    """Return sum of (p - A x)^2 and number of rays of each view, and the RMS of p."""
    A = Projector(geometry, volume.grid)
    inside = A(np.ones(volume.shape, np.float32)) > 0
    if bad is not None:
        inside &= ~bad
    off = np.where(inside, line_integrals - A(volume.array), 0.0)
    rays = np.maximum(inside.sum(axis=(1, 2)), 1)
    whole = math.sqrt(float(np.square(line_integrals[inside], dtype=np.float64).mean() or 1.0))
    return np.square(off, dtype=np.float64).sum(axis=(1, 2)), rays, whole


MOST_FOR_THRESHOLD = 10**6
"""Largest number of voxels from which the threshold is taken."""


def _edge_width(volume: Volume, region: Bools) -> float:
    from skimage import filters

    threshold_otsu: Any = getattr(filters, "threshold_otsu")  # noqa: B009 - typed in part only
    values = volume.array[region]
    if not values.size or np.ptp(values) == 0:
        return math.nan
    threshold = threshold_otsu(values[:: max(1, values.size // MOST_FOR_THRESHOLD)])
    above = volume.array > threshold
    level = float(volume.array[region & above].mean())
    body = np.where(above, np.float32(level), np.float32(0))
    return float(edges_of(body, region, level, volume.grid).width(volume.array))
