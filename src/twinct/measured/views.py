"""Views of a measured scan as its geometry states them, and the cutting of its panel."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from twinct.core.errors import InputError
from twinct.geometry import Floats, Panel, ScanGeometry


@dataclass(frozen=True)
class StatedViews:
    """Views that a geometry states.

    Attributes:
        geometry: the views, in twinct's convention.
        flip_rows: True if the rows of the images run against v.
        flip_columns: True if the columns of the images run against u.
        notes: sentences on what was read, with units.
        doubts: sentences on statements that contradict each other.
    """

    geometry: ScanGeometry
    flip_rows: bool = False
    flip_columns: bool = False
    notes: tuple[str, ...] = field(default=())
    doubts: tuple[str, ...] = field(default=())


@dataclass(frozen=True)
class ImageFacts:
    """Facts on the stored images, turned as the description states.

    Attributes:
        views: number of images.
        rows: rows of an image.
        columns: columns of an image.
        spacing: pitch along (u, v) that the files state, mm, or None.
        first_pixel: place of pixel (0, 0) along (u, v) on the panel that the files state, mm.
    """

    views: int
    rows: int
    columns: int
    spacing: tuple[float, float] | None = None
    first_pixel: tuple[float, float] | None = None

    def panel(self, pitch_mm: float | tuple[float, float]) -> Panel:
        """Return the panel of these images with a pitch: one, or (along u, along v)."""
        pitch_u, pitch_v = pitch_mm if isinstance(pitch_mm, tuple) else (pitch_mm, pitch_mm)
        return Panel(self.rows, self.columns, pitch_u, pitch_v)

    def require(self, where: str, views: int, panel: Panel | None = None) -> None:
        """Check that a geometry states as many views and pixels as there are.

        Raises:
            InputError: it does not; both numbers are named.
        """
        if views != self.views:
            raise InputError(f"{where}: states {views} views, but there are {self.views} images")
        if panel is not None and panel.shape != (self.rows, self.columns):
            raise InputError(
                f"{where}: states {panel.rows} x {panel.columns} pixels (rows x columns), but the "
                f"images have {self.rows} x {self.columns}"
            )


def views_of(
    where: str, source: ArrayLike, detector: ArrayLike, u: ArrayLike, v: ArrayLike, panel: Panel
) -> tuple[ScanGeometry, bool]:
    """Return a geometry from vectors that may have rounding errors, and whether v was reversed.

    Args:
        where: beginning of messages.
        source: focal spots, (views, 3), mm.
        detector: panel centres, (views, 3), mm.
        u: directions of increasing columns, (views, 3), of any length.
        v: directions of increasing rows, (views, 3).
        panel: the panel.

    Raises:
        InputError: the vectors form no geometry.
    """
    source, detector, u, v = (np.asarray(a, np.float64) for a in (source, detector, u, v))
    if not all(np.isfinite(a).all() for a in (source, detector, u, v)):
        raise InputError(f"{where}: a number is not finite")
    try:
        u, v = _orthonormal(where, u, v)
        towards = np.einsum("vk,vk->v", np.cross(u, v), source - detector)
        mirrored = bool((towards < 0).all())
        return ScanGeometry(source, detector, u, -v if mirrored else v, panel), mirrored
    except ValueError as error:
        raise InputError(f"{where}: {error}") from None


SKEW = 1e-3
"""Largest cosine of the angle between rows and columns of a panel."""


def _orthonormal(where: str, u: Floats, v: Floats) -> tuple[Floats, Floats]:
    """Return unit vectors at right angles: v by the smallest change, in the plane of both."""
    lengths = [np.linalg.norm(axis, axis=1, keepdims=True) for axis in (u, v)]
    if any((length == 0).any() for length in lengths):
        raise InputError(f"{where}: an axis of a panel has no length")
    u, v = u / lengths[0], v / lengths[1]
    skew = np.einsum("vk,vk->v", u, v)
    if (worst := np.abs(skew).max()) > SKEW:
        view = int(np.abs(skew).argmax())
        raise InputError(
            f"{where}: rows and columns of view {view} are not at right angles, but at "
            f"{np.degrees(np.arccos(worst)):.2f} deg"
        )
    v = v - skew[:, None] * u
    return u, v / np.linalg.norm(v, axis=1, keepdims=True)


def cut(geometry: ScanGeometry, rows: tuple[int, int], columns: tuple[int, int]) -> ScanGeometry:
    """Return the views with a part of their panel.

    Args:
        geometry: views of the whole panel.
        rows: first row, and the row after the last.
        columns: first column, and the column after the last.
    """
    panel = geometry.panel
    part = replace(panel, rows=rows[1] - rows[0], columns=columns[1] - columns[0])
    moved_u = ((columns[0] + columns[1] - 1) / 2 - panel.middle[0]) * panel.pitch_u
    moved_v = ((rows[0] + rows[1] - 1) / 2 - panel.middle[1]) * panel.pitch_v
    centre = geometry.detector + moved_u * geometry.u + moved_v * geometry.v
    return replace(geometry, detector=centre, panel=part)
