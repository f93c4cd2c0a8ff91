"""Possible motion between believed and executed geometry, and the prior on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from twinct.calibration.resection import moved
from twinct.core.errors import InputError
from twinct.geometry import Floats, Pose, ScanGeometry

What = Literal["arms", "patient"]
"""Moving part: source and panel, nine numbers per view, or the patient between them, six."""

SHIFTS = {"arms": 6, "patient": 3}
"""Number of shifts among the numbers; three turns follow."""

STEP_MM, STEP_RAD = 0.3, 0.004
"""Steps of the finite differences: about a third of a pixel."""

NUGGET = 0.02
"""Share of a smooth error's variance that is white; it keeps the covariance regular."""


@dataclass(frozen=True)
class PosePrior:
    """Expected errors of the believed poses, of source and panel or of the patient.

    Attributes:
        sigma_mm: Expected position error along each axis, mm.
        sigma_deg: Expected rotation error about each axis, degrees.
        correlation_views: Number of views over which errors are correlated (a Gaussian process); 0:
            independent errors.
    """

    sigma_mm: float = 0.5
    sigma_deg: float = 0.2
    correlation_views: float = 0.0

    def __post_init__(self) -> None:
        """Raise ``InputError`` for a number out of range."""
        for key, value in (("sigma_mm", self.sigma_mm), ("sigma_deg", self.sigma_deg)):
            if not value > 0:
                raise InputError(f"{key} {value:g}: must be more than 0")
        if not self.correlation_views >= 0:
            raise InputError(f"correlation_views {self.correlation_views:g}: must be at least 0")

    def precision(self, views: int, what: What = "arms") -> Floats:
        """Return the inverse covariance of all errors, (views * n, views * n)."""
        own = np.array([self.sigma_mm] * SHIFTS[what] + [np.radians(self.sigma_deg)] * 3)
        over = np.eye(views)
        if self.correlation_views > 0:
            apart = np.subtract.outer(np.arange(views), np.arange(views)) / self.correlation_views
            over = (1 - NUGGET) * np.exp(-(apart**2) / 2) + NUGGET * over
        return np.asarray(np.kron(np.linalg.inv(over), np.diag(1 / own**2)), np.float64)


@dataclass(frozen=True, eq=False)
class Freedom:
    """Parametrisation of each view's motion.

    Attributes:
        what: moving part.
        middle: centre of a patient's turns, (3,), mm.
    """

    what: What
    middle: Floats

    @property
    def steps(self) -> Floats:
        """Step of each number for finite differences, (n,), mm and rad."""
        return np.array([STEP_MM] * SHIFTS[self.what] + [STEP_RAD] * 3)

    def view(self, believed: ScanGeometry, change: Floats) -> ScanGeometry:
        """Return one view, moved."""
        if self.what == "arms":
            return moved(believed, change)
        about = Pose(self.middle, Pose.identity().quat)
        return (about @ Pose.exp(change) @ about.inverse()) @ believed

    def all(self, believed: ScanGeometry, change: Floats) -> ScanGeometry:
        """Return all views, each moved by its own numbers, (views, n)."""
        if self.what == "arms":
            return moved(believed, change)
        parts = [self.view(view, one) for view, one in zip(believed, change, strict=True)]
        return ScanGeometry.joined(parts)

    def tangents(self, believed: ScanGeometry, change: Floats, factor: int = 1) -> Floats:
        """Return the derivatives of S, D, u and v of each view by its numbers, (views, n, 4, 3).

        Args:
            believed: the geometry at zero.
            change: the numbers of each view, (views, n).
            factor: binning factor of the pixels.
        """

        def vectors(at: Floats) -> Floats:
            view = self.all(believed, at).binned(factor, factor)
            return np.stack([view.source, view.detector, view.u, view.v], axis=1)

        return np.stack(
            [
                (vectors(change + one) - vectors(change - one)) / (2 * one.sum())
                for one in np.diag(self.steps)
            ],
            axis=1,
        )
