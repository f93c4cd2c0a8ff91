"""Geometry from projection matrices, and from a table of poses.

A matrix P maps a point (x, y, z, 1) to (a w, b w, w). With M = P[:, :3], the source is
S = -M^-1 P[:, 3], and the rays of steps along the panel are M^-1 times unit vectors (Hartley and
Zisserman, Multiple View Geometry, 2004, section 6.2). The pitch gives the distance of the panel.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from twinct.core.errors import InputError
from twinct.core.settings import Length, Pair, Section, setting
from twinct.geometry import Floats, Panel
from twinct.measured.numbers import read_numbers
from twinct.measured.views import ImageFacts, StatedViews, views_of

UNEQUAL = 0.01
"""Largest deviation of a matrix's ratio of the pitches from the stated one."""

_RANK = 1e-10
"""Smallest ratio of the singular values of a matrix of full rank, with axes scaled alike."""

_TO_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0}


class Matrices(Section):
    """Projection matrices: (x, y, z, 1) to (column w, row w, w)."""

    kind: Literal["matrices"]
    path: Path = Field(description="File of 3 x 4 matrices: .npy, .npz, or 12 numbers a line.")
    array: str = setting("", "Name of the array in an .npz file.")
    to: Literal["px", "mm"] = Field(description="Unit of column and row on the panel.")
    origin: Literal["pixel_centre", "pixel_corner", "panel_centre"] = Field(
        description="Point (0, 0): centre or outer corner of the first pixel, or the panel's centre"
    )
    pitch_mm: Length | Pair = Field(description="Pixel pitch; two for (columns, rows).")
    world: Literal["mm", "cm", "m"] = setting("mm", "Unit of x, y and z.")

    def views(self, facts: ImageFacts) -> StatedViews:
        """Return the views.

        Raises:
            InputError: the matrices do not fit the images, lack full rank, or have other pitches.
        """
        where = f"{self.path}: matrices"
        numbers = read_numbers(self.path, self.array, where)
        if numbers.size % 12 or numbers.shape[-1] not in (4, 12):
            raise InputError(f"{where}: shape {numbers.shape}; expected (views, 3, 4)")
        matrices = numbers.reshape(-1, 3, 4)
        facts.require(where, len(matrices))
        panel = facts.panel(self.pitch_mm)
        to_world = np.diag([_TO_MM[self.world]] * 3 + [1.0])
        matrices = matrices @ np.linalg.inv(to_world)
        views = views_of_matrices(where, self._to_pixels(panel) @ matrices, panel)
        note = f"{len(matrices)} projection matrices to {self.to} from the {self.origin}"
        return StatedViews(views.geometry, views.flip_rows, notes=(note, *views.notes))

    def _to_pixels(self, panel: Panel) -> Floats:
        """Return the matrix from the stated coordinates to pixels from the first pixel's centre."""
        scale = (1.0, 1.0) if self.to == "px" else (1 / panel.pitch_u, 1 / panel.pitch_v)
        shift = {
            "pixel_centre": (0.0, 0.0),
            "pixel_corner": (-0.5, -0.5),
            "panel_centre": panel.middle,
        }[self.origin]
        return np.array([[scale[0], 0, shift[0]], [0, scale[1], shift[1]], [0, 0, 1.0]])


def views_of_matrices(where: str, matrices: Floats, panel: Panel) -> StatedViews:
    """Return the views of matrices (views, 3, 4) from mm to pixels (column w, row w, w).

    Raises:
        InputError: a matrix lacks full rank, or has other pitches or a skew panel.
    """
    square = matrices[:, :, :3]
    _check_rank(where, square)
    source = -np.linalg.solve(square, matrices[:, :, 3:])[:, :, 0]
    rays = np.linalg.inv(square)  # columns: steps of one column, of one row, and pixel (0, 0)
    scale = panel.pitch_u / np.linalg.norm(rays[:, :, 0], axis=1)
    middle = rays @ np.array([*panel.middle, 1.0])
    # w has one sign before the source: that of the world's origin.
    ahead = np.sign(matrices[:, 2, 3])
    if (ahead == 0).any():
        raise InputError(
            f"{where}: matrix {int((ahead == 0).argmax())}: the origin of the world lies beside "
            "the source, so that the side of the panel is not known"
        )
    scale *= ahead
    detector = source + scale[:, None] * middle
    u, v = (scale[:, None] * rays[:, :, axis] for axis in (0, 1))
    ratio = np.linalg.norm(v, axis=1) / panel.pitch_v
    if (off := np.abs(ratio - 1)).max() > UNEQUAL:
        view = int(off.argmax())
        raise InputError(
            f"{where}: matrix {view} has rows {ratio[view] * panel.pitch_v:.4g} mm apart where "
            f"columns are {panel.pitch_u:.4g} mm apart, but the stated pitch of rows is "
            f"{panel.pitch_v:.4g} mm"
        )
    geometry, flipped = views_of(where, source, detector, u, v, panel)
    notes = (
        f"source to panel {geometry.sdd.min():.6g} to {geometry.sdd.max():.6g} mm, from the pitch "
        f"of {panel.pitch_u:g} x {panel.pitch_v:g} mm",
    )
    return StatedViews(geometry, flip_rows=flipped, notes=notes)


def _check_rank(where: str, square: Floats) -> None:
    sized = square / np.maximum(np.linalg.norm(square, axis=2, keepdims=True), 1e-300)
    values = np.linalg.svd(sized, compute_uv=False)
    flat = values[:, -1] <= _RANK * values[:, 0]
    if flat.any():
        raise InputError(
            f"{where}: matrix {int(flat.argmax())} lacks full rank: it states no source"
        )


class Poses(Section):
    """Table of poses, a line for each view."""

    kind: Literal["poses"]
    path: Path = Field(
        description="Lines of 12 numbers: source, panel's centre, u (along columns), v (along "
        "rows); or of 10: source, panel's centre, quaternion of the panel."
    )
    array: str = setting("", "Name of the array in an .npz file.")
    pitch_mm: Length | Pair = Field(description="Pixel pitch; two for (columns, rows).")
    unit: Literal["mm", "cm", "m"] = setting("mm", "Unit of the positions.")
    quaternion: Literal["xyzw", "wxyz"] = setting(
        "xyzw", "Order of a quaternion, which turns x and y to u and v."
    )

    def views(self, facts: ImageFacts) -> StatedViews:
        """Return the views.

        Raises:
            InputError: the table does not fit the images, or holds no poses.
        """
        where = f"{self.path}: poses"
        table = read_numbers(self.path, self.array, where)
        if table.ndim != 2 or table.shape[1] not in (10, 12):
            raise InputError(f"{where}: shape {table.shape}; expected (views, 12) or (views, 10)")
        facts.require(where, len(table))
        places = table[:, :6] * _TO_MM[self.unit]
        if table.shape[1] == 12:
            u, v = table[:, 6:9], table[:, 9:12]
        else:
            quat = table[:, 6:] if self.quaternion == "xyzw" else np.roll(table[:, 6:], -1, axis=1)
            if (length := np.linalg.norm(quat, axis=1)).min() < 0.5:
                raise InputError(f"{where}: quaternion {int(length.argmin())} has no length")
            axes = Rotation.from_quat(quat).as_matrix()
            u, v = axes[:, :, 0], axes[:, :, 1]
        panel = facts.panel(self.pitch_mm)
        geometry, flipped = views_of(where, places[:, :3], places[:, 3:], u, v, panel)
        note = f"{len(table)} poses of {table.shape[1]} numbers, in {self.unit}"
        return StatedViews(geometry, flip_rows=flipped, notes=(note,))
