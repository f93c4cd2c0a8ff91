"""The pixel lattice of a flat panel."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Panel:
    """The pixel lattice of a flat panel.

    Attributes:
        rows: pixels along v.
        columns: pixels along u.
        pitch_u: pixel pitch along u, mm.
        pitch_v: pixel pitch along v, mm.
    """

    rows: int
    columns: int
    pitch_u: float
    pitch_v: float

    def __post_init__(self) -> None:
        """Refuse a panel without pixels."""
        if self.rows < 1 or self.columns < 1 or not (self.pitch_u > 0 and self.pitch_v > 0):
            raise ValueError(f"{self} has no pixels")

    @property
    def shape(self) -> tuple[int, int]:
        """Image shape (rows, columns)."""
        return self.rows, self.columns

    @property
    def size_mm(self) -> tuple[float, float]:
        """Active width along u and height along v, mm."""
        return self.columns * self.pitch_u, self.rows * self.pitch_v
