"""Residuals of predicted line integrals, and how much of them each cause could explain.

Residuals r = p - q of measured p and predicted q are fitted by least squares, one cause after the
other, each to what the causes before it left:

- calibration, view by view: shift, turn and scale of the shadow, r = -(du, dv) . grad q;
- spectrum, one curve for all views: r = a q + b q^2 + c q^3;
- scatter and detector, view by view: a polynomial of second degree in column and row.

A cause can also take part of what another one left: the figures say what it could explain at most.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Singles = NDArray[np.float32]
Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

CAUSES = "calibration", "spectrum", "scatter"
"""Causes in the order in which they are taken away."""

POWERS = 1, 2, 3
"""Powers of the line integral in the curve of the spectrum."""

CURVE_BINS = 40


@dataclass(frozen=True)
class ViewResidual:
    """Residual of one view.

    Attributes:
        view: its number in the scan.
        rms: root mean square of p - q over the rays that count.
        rms_rel: the same, relative to that of p in all views.
        mean: mean of p - q.
        shift_px: measured minus predicted place of the shadow, (columns, rows), px.
        left_rel: root mean squares that remain after each of ``CAUSES``, as ``rms_rel``.
    """

    view: int
    rms: float
    rms_rel: float
    mean: float
    shift_px: tuple[float, float]
    left_rel: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals of all predicted views.

    Attributes:
        views: one for each predicted view.
        rms_rel: root mean square of p - q over all of them, relative to that of p.
        left_rel: what remains of it after each of ``CAUSES``.
        curve: mean of p - q, by the predicted line integral, before any cause is taken away: rows
            of (q, mean).
    """

    views: tuple[ViewResidual, ...]
    rms_rel: float
    left_rel: tuple[float, float, float]
    curve: Floats


def residuals_of(
    numbers: NDArray[np.intp], measured: Singles, predicted: Singles, counts: Bools
) -> Residuals:
    """Return the residuals of views, and their rest after each cause.

    Args:
        numbers: numbers of the views in the scan, (views,).
        measured: line integrals, (views, rows, columns).
        predicted: the same.
        counts: rays that count, (views, rows, columns).
    """
    rays = np.maximum(counts.sum(axis=(1, 2)), 1)
    whole = math.sqrt(float(np.square(measured[counts], dtype=np.float64).mean())) or 1.0
    given = measured - predicted
    given[~counts] = 0
    moved = given.copy()
    shifts: list[tuple[float, float]] = []
    for view, q in enumerate(predicted):
        shift, explained = _fitted(_motions(q), moved[view], counts[view])
        moved[view] -= explained
        shifts.append((-float(shift[0]), -float(shift[1])))
    moved[~counts] = 0
    curve = _common_curve(predicted, moved, counts)
    bent = moved - sum(np.float32(c) * predicted**n for c, n in zip(curve, POWERS, strict=True))
    bent[~counts] = 0
    smooth = bent.copy()
    for view in range(len(smooth)):
        smooth[view] -= _fitted(_polynomials(smooth.shape[1:]), smooth[view], counts[view])[1]
    smooth[~counts] = 0
    stages = np.array([_squares(stage) for stage in (given, moved, bent, smooth)])
    by_view, together = np.sqrt(stages / rays) / whole, np.sqrt(stages.sum(1) / rays.sum()) / whole
    means = given.sum(axis=(1, 2), dtype=np.float64) / rays
    views = tuple(
        ViewResidual(
            view=int(number),
            rms=float(by_view[0, k] * whole),
            rms_rel=float(by_view[0, k]),
            mean=float(means[k]),
            shift_px=shifts[k],
            left_rel=(float(by_view[1, k]), float(by_view[2, k]), float(by_view[3, k])),
        )
        for k, number in enumerate(numbers)
    )
    left = float(together[1]), float(together[2]), float(together[3])
    return Residuals(views, float(together[0]), left, _mean_curve(predicted, given, counts))


def _squares(stage: Singles) -> Floats:
    return np.square(stage, dtype=np.float64).sum(axis=(1, 2))


def _motions(image: Singles) -> Iterator[NDArray[np.floating]]:
    """Yield the changes of an image by shifts along columns and rows, a scale and a turn.

    The last two are about the middle of the shadow's edges, so that they move it as little as they
    can: elsewhere a scale of a small shadow would be a shift.
    """
    down, right = (np.asarray(np.gradient(image, axis=axis)) for axis in (0, 1))
    rows, columns = (np.arange(n, dtype=np.float32) for n in image.shape)
    edges = right**2 + down**2
    total = max(float(edges.sum()), 1e-30)
    x = (columns - edges.sum(axis=0) @ columns / total) / max(image.shape)
    y = (rows - edges.sum(axis=1) @ rows / total)[:, None] / max(image.shape)
    yield right
    yield down
    yield right * x + down * y
    yield right * -y + down * x


def _polynomials(shape: tuple[int, ...]) -> Iterator[NDArray[np.floating]]:
    """Yield the terms of a polynomial of second degree, (rows, columns)."""
    rows, columns = (np.linspace(-1, 1, n, dtype=np.float32) for n in shape)
    y, x = np.meshgrid(rows, columns, indexing="ij")
    yield from (np.ones_like(x), x, y, x * x, x * y, y * y)


def _fitted(
    terms: Iterator[NDArray[np.floating]], image: Singles, counts: Bools
) -> tuple[Floats, Singles]:
    """Return the factors of terms that fit an image best where it counts, and their sum."""
    basis = np.stack(list(terms))
    factors, *_ = np.linalg.lstsq(basis[:, counts].T.astype(float), image[counts], rcond=None)
    gains = np.asarray(factors, np.float64)
    return gains, np.tensordot(gains.astype(np.float32), basis.astype(np.float32), axes=1)


def _common_curve(predicted: Singles, left: Singles, counts: Bools) -> Floats:
    """Return the factors of the powers of q that fit all views best."""
    normal, right = np.zeros((len(POWERS), len(POWERS))), np.zeros(len(POWERS))
    for q, r, there in zip(predicted, left, counts, strict=True):
        basis = q[there].astype(float) ** np.array(POWERS)[:, None]
        normal += basis @ basis.T
        right += basis @ r[there]
    return np.asarray(np.linalg.lstsq(normal, right, rcond=None)[0], np.float64)


def _mean_curve(predicted: Singles, given: Singles, counts: Bools) -> Floats:
    top = max(float(predicted[counts].max(initial=0.0)), 1e-6)
    at = np.clip((predicted[counts] / top * CURVE_BINS).astype(int), 0, CURVE_BINS - 1)
    many = np.bincount(at, minlength=CURVE_BINS)
    sums = np.bincount(at, given[counts], minlength=CURVE_BINS)
    filled = many > 0
    middles = (np.arange(CURVE_BINS) + 0.5) * top / CURVE_BINS
    return np.stack([middles[filled], sums[filled] / many[filled]], axis=1)
