"""What may have moved between believed and true geometry, and what is known of it beforehand."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from twinct.calibration.resection import moved
from twinct.geometry import Floats, Pose, ScanGeometry

What = Literal["arms", "patient"]
"""What may have moved: source and panel, nine numbers a view, or the patient between, six."""

SHIFTS = {"arms": 6, "patient": 3}
"""How many of the numbers are shifts; three turns follow."""

STEP_MM, STEP_RAD = 0.3, 0.004
"""Of the differences that stand for derivatives: about a third of a pixel."""

NUGGET = 0.02
"""Share of a smooth error's variance that is not smooth: the covariance stays regular."""


@dataclass(frozen=True)
class PosePrior:
    """What is known of the errors beforehand.

    Attributes:
        sigma_mm: of source and panel, or of the patient, along each axis.
        sigma_deg: of the panel, or of the patient, about each axis.
        correlation_views: over how many views errors stay alike (a Gaussian process); 0: each view
            has its own.
    """

    sigma_mm: float = 0.5
    sigma_deg: float = 0.2
    correlation_views: float = 0.0

    def precision(self, views: int, what: What = "arms") -> Floats:
        """Inverse covariance of all errors, (views * n, views * n)."""
        own = np.array([self.sigma_mm] * SHIFTS[what] + [np.radians(self.sigma_deg)] * 3)
        over = np.eye(views)
        if self.correlation_views > 0:
            apart = np.subtract.outer(np.arange(views), np.arange(views)) / self.correlation_views
            over = (1 - NUGGET) * np.exp(-(apart**2) / 2) + NUGGET * over
        return np.asarray(np.kron(np.linalg.inv(over), np.diag(1 / own**2)), np.float64)


@dataclass(frozen=True, eq=False)
class Freedom:
    """How each view follows its numbers.

    Attributes:
        what: may have moved.
        middle: about which a patient turns, (3,), mm.
    """

    what: What
    middle: Floats

    @property
    def steps(self) -> Floats:
        """Of each number, (n,), mm and rad."""
        return np.array([STEP_MM] * SHIFTS[self.what] + [STEP_RAD] * 3)

    def view(self, believed: ScanGeometry, change: Floats) -> ScanGeometry:
        """One view, moved."""
        if self.what == "arms":
            return moved(believed, change)
        about = Pose(self.middle, Pose.identity().quat)
        return (about @ Pose.exp(change) @ about.inverse()) @ believed

    def all(self, believed: ScanGeometry, change: Floats) -> ScanGeometry:
        """Each view, moved by its own numbers, (views, n)."""
        if self.what == "arms":
            return moved(believed, change)
        parts = [self.view(view, one) for view, one in zip(believed, change, strict=True)]
        return ScanGeometry.joined(parts)
