"""Focal spots as points of equal weight."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy

from twinct.core.errors import InputError
from twinct.geometry import Floats, ScanGeometry

# Steps of the R2 sequence (Roberts 2018): evenly spread along every line through the square.
_PLASTIC = 1.32471795724474602596
_STEPS = np.array([1 / _PLASTIC, 1 / _PLASTIC**2])


def unit_square(samples: int) -> Floats:
    """Return evenly spread points of the unit square, (samples, 2), from which spots are shaped."""
    return np.mod(0.5 + np.arange(1, samples + 1)[:, None] * _STEPS, 1.0)


def square_spot(size_x_mm: float, size_y_mm: float, unit: Floats) -> Floats:
    """Return points of a rectangle of constant intensity, (points, 2), mm, from ``unit_square``.

    As for a Gaussian, the variances are exactly those of the spot.
    """
    points = (unit - 0.5) * [size_x_mm, size_y_mm]
    return _with_variance(points, np.array([size_x_mm, size_y_mm]) ** 2 / 12)


def gaussian_spot(sigma_x_mm: float, sigma_y_mm: float, unit: Floats) -> Floats:
    """Return points of a Gaussian, (points, 2), mm."""
    sigma = np.array([sigma_x_mm, sigma_y_mm])
    return _with_variance(scipy.special.ndtri(unit) * sigma, sigma**2)


def image_spot(intensity: Floats, size_x_mm: float, size_y_mm: float, unit: Floats) -> Floats:
    """Return points of a measured spot, (points, 2), mm, about the middle of its image.

    Args:
        intensity: (rows, columns); columns along x, row 0 at the lowest y.
        size_x_mm: width of the whole image.
        size_y_mm: height of the whole image.
        unit: points of the unit square.

    Raises:
        InputError: there is no image, or its intensity is negative, not finite or zero everywhere.
    """
    intensity = np.asarray(intensity, dtype=float)
    what = "the image of a focal spot"
    if intensity.ndim != 2:
        raise InputError(f"{what} must have rows and columns, not shape {intensity.shape}")
    if not np.isfinite(intensity).all():
        raise InputError(f"{what} must have finite intensity, not NaN or infinite")
    if (intensity < 0).any():
        raise InputError(f"{what} must not have negative intensity, but has {intensity.min():g}")
    if not intensity.any():
        raise InputError(f"{what} needs intensity, but is 0 everywhere")
    rows, columns = intensity.shape
    by_column = np.concatenate([[0], np.cumsum(intensity.sum(axis=0))])
    x = np.interp(unit[:, 0] * by_column[-1], by_column, np.arange(columns + 1))
    column = np.minimum(x.astype(int), columns - 1)
    y = np.empty(len(unit))
    for i, c in enumerate(column):
        by_row = np.concatenate([[0], np.cumsum(intensity[:, c])])
        y[i] = np.interp(unit[i, 1] * by_row[-1], by_row, np.arange(rows + 1))
    return np.stack([(x / columns - 0.5) * size_x_mm, (y / rows - 0.5) * size_y_mm], axis=1)


def moved_source(view: ScanGeometry, offset_mm: Floats) -> ScanGeometry:
    """Return a view whose source is moved in the source frame's x and y; the panel stays."""
    axes = view.source_poses()[0].rotation
    return replace(view, source=view.source + offset_mm @ axes[:, :2].T)


def _with_variance(points: Floats, variance: Floats) -> Floats:
    points = points - points.mean(axis=0)
    spread = points.var(axis=0)
    factor = np.sqrt(np.divide(variance, spread, out=np.zeros(2), where=spread > 0))
    return points * factor
