"""Geometry of a circular scan from its projections: by planes, after a slice where they need one.

Planes through pairs of sources tell up to six numbers of the panel (``circular``), but no axis in a
parallel beam or from few rows. There a slice finds the axis (``axis_offset``), and the planes take
it as known, as precisely as the slice tells it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from twinct.calibration.axis_offset import axis_offset
from twinct.calibration.circular import (
    FINE_PX,
    NUMBERS,
    WHAT,
    CircularCalibration,
    CircularPrior,
    Undetermined,
    circle_numbers,
    circular_consistent,
)
from twinct.calibration.consistency import SMALLEST
from twinct.core.errors import CalibrationError
from twinct.core.progress import SILENT, Progress
from twinct.geometry import ScanGeometry
from twinct.recon import fit_circle


def circle_found(
    line_integrals: NDArray[np.float32],
    believed: ScanGeometry,
    prior: CircularPrior | None = None,
    *,
    mask: NDArray[np.bool_] | None = None,
    progress: Progress = SILENT,
) -> CircularCalibration:
    """Return the geometry of a circular scan that its projections agree with.

    Args:
        line_integrals: (views, rows, columns).
        believed: approximate geometry, a circle.
        prior: prior on the errors.
        mask: True where a pixel counts, (rows, columns) or (views, rows, columns).
        progress: receives a step for each round.

    Raises:
        InputError: the geometry is no circle, or arrays have other shapes or values that are not
            finite.
        CalibrationError: neither planes nor a slice tell the axis.
    """
    prior, pitch = prior or CircularPrior(), believed.panel.pitch_u

    def by_planes(geometry: ScanGeometry, own: CircularPrior) -> CircularCalibration | None:
        try:
            return circular_consistent(line_integrals, geometry, own, mask=mask, progress=progress)
        except CalibrationError:
            return None

    few = believed.panel.rows < SMALLEST
    result = None if few else by_planes(believed, prior)
    if result is not None and result.deviation[0] <= FINE_PX * pitch:
        return result
    circle = fit_circle(believed, WHAT)
    axis = axis_offset(line_integrals, believed, circle, mask=mask, progress=progress)
    if result is not None and result.deviation[0] <= axis.deviation_mm:
        return result
    moved = replace(believed, detector=believed.detector + axis.shift_mm * believed.u)
    known = replace(prior, axis_px=axis.deviation_mm / pitch)
    further = None if few else by_planes(moved, known)
    further = further or _untouched(moved, known)
    change = further.change + axis.shift_mm * (np.arange(len(NUMBERS)) == 0)
    before = circle_numbers(believed, circle)
    return replace(further, change=change, before=before, residuals=axis.residuals)


def _untouched(geometry: ScanGeometry, prior: CircularPrior) -> CircularCalibration:
    """Return a geometry of which the views tell no number beside the axis."""
    numbers, nothing = circle_numbers(geometry), np.zeros(len(NUMBERS))
    open_ones = tuple(Undetermined((name,), (1.0,), 1.0) for name in NUMBERS[1:])
    deviations = prior.deviations(geometry)
    return CircularCalibration(
        geometry, nothing, deviations, numbers, numbers, open_ones, (np.nan, np.nan)
    )
