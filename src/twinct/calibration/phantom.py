"""A phantom of balls: nominal centres and their tolerance."""

from __future__ import annotations

from dataclasses import dataclass

from twinct.geometry import Floats, Pose
from twinct.geometry.arrays import frozen


@dataclass(frozen=True, eq=False)
class BallPhantom:
    """Balls at known positions.

    Attributes:
        centres: nominal centres in the world, (balls, 3), mm.
        radius_mm: of each ball.
        tolerance_mm: standard deviation of a centre along each axis.
    """

    centres: Floats
    radius_mm: float
    tolerance_mm: float = 0.0

    def __post_init__(self) -> None:
        """Copy and freeze the centres."""
        object.__setattr__(self, "centres", frozen(self.centres, (len(self.centres), 3), "centres"))

    def __len__(self) -> int:
        """Return the number of balls."""
        return len(self.centres)

    def __rmatmul__(self, outer_from_inner: Pose) -> BallPhantom:
        """Return ``world_from_specimen @ phantom``: the balls in another frame."""
        centres = outer_from_inner.apply(self.centres)
        return BallPhantom(centres, self.radius_mm, self.tolerance_mm)
