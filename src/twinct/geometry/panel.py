"""Pixel lattice of a flat panel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twinct.geometry.arrays import Floats


@dataclass(frozen=True)
class Panel:
    """Pixel lattice of a flat panel: rows along v, columns along u, pitches in mm."""

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

    @property
    def middle(self) -> tuple[float, float]:
        """Centre of the panel, (column, row)."""
        return (self.columns - 1) / 2, (self.rows - 1) / 2

    @property
    def first_pixel_mm(self) -> tuple[float, float]:
        """Centre of pixel (0, 0) along u and v, relative to the panel's centre, mm."""
        return -(self.columns - 1) / 2 * self.pitch_u, -(self.rows - 1) / 2 * self.pitch_v

    @property
    def mm_from_pixel(self) -> Floats:
        """Matrix (3, 3) from (column, row, 1) to (u, v, 1) relative to the panel's centre, mm."""
        u, v = self.first_pixel_mm
        return np.array([[self.pitch_u, 0.0, u], [0.0, self.pitch_v, v], [0.0, 0.0, 1.0]])

    def divided(self, parts: int) -> Panel:
        """Return a panel of the same area, with each pixel divided into ``parts`` x ``parts``."""
        rows, columns = self.rows * parts, self.columns * parts
        return Panel(rows, columns, self.pitch_u / parts, self.pitch_v / parts)

    def binned(self, rows: int, columns: int) -> Panel:
        """Return a panel with ``rows`` x ``columns`` pixels binned into one, from pixel (0, 0) on.

        Last rows and columns that do not fill a pixel are left out.

        Raises:
            ValueError: no pixel is left.
        """
        pitches = self.pitch_u * columns, self.pitch_v * rows
        return Panel(self.rows // rows, self.columns // columns, *pitches)
