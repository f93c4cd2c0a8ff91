"""Models of solids on half a lattice (x >= 0), whose other half is its mirror image.

A canvas becomes a closed surface, or one solid for the kernels.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy
from numpy.typing import ArrayLike

from twinct.geometry import Floats
from twinct.specimen.implicit import ADD, KEEP, LATTICE, Field, Form, ImplicitSolid, smin
from twinct.specimen.surface import isosurface

if TYPE_CHECKING:
    import trimesh

KNOWN_MM = 2.5
"""Distance from a solid up to which its canvas holds true values."""


class Canvas:
    """Signed distances on half a lattice, on which solids are drawn one after the other.

    A solid is evaluated only within its box; further away it has no effect, except a bound.
    """

    def __init__(self, step: float, lowest: ArrayLike, highest: ArrayLike) -> None:
        self.step, self.origin = step, np.asarray(lowest, dtype=float)
        counts = np.ceil(np.subtract(highest, lowest) / step).astype(int) + 1
        self.axes = [
            np.asarray(low + step * np.arange(n), dtype=np.float32)
            for low, n in zip(self.origin, counts, strict=True)
        ]
        self.field: Field = np.full(counts, 50.0, dtype=np.float32)

    @property
    def mirrored(self) -> Field:
        """Full field, both halves."""
        return np.concatenate([self.field[:0:-1], self.field])

    @property
    def affine(self) -> Floats:
        """Affine map (4, 4) from indices of the full field to mm."""
        affine = np.diag([self.step, self.step, self.step, 1.0])
        affine[:3, 3] = self.origin
        affine[0, 3] = -self.step * (self.field.shape[0] - 1)
        return affine

    def draw(self, *solids: ImplicitSolid) -> None:
        """Join solids with what is drawn, each in its own way."""
        for solid in solids:
            part = self._part(solid)
            axes = (axis[cut] for axis, cut in zip(self.axes, part, strict=True))
            distance, field = solid(*np.ix_(*axes)), self.field[part]
            if solid.op == ADD:
                self.field[part] = smin(field, distance, solid.blend)
            else:
                bound = -distance if solid.op == KEEP else distance
                self.field[part] = -smin(-field, bound, solid.blend)

    def _part(self, solid: ImplicitSolid) -> tuple[slice, ...]:
        """Return the part of the lattice that a solid may change."""
        if solid.op == KEEP:
            return (slice(None),) * 3
        margin = solid.blend + 3.0
        return tuple(
            slice(int(np.searchsorted(axis, low)), int(np.searchsorted(axis, high, side="right")))
            for axis, low, high in zip(
                self.axes, solid.low - margin, solid.high + margin, strict=True
            )
        )

    def surface(self) -> trimesh.Trimesh:
        """Return the closed surface of both halves."""
        return isosurface(-self.mirrored, 0.0, self.affine)

    def solid(self, middle: ArrayLike = (0, 0, 0)) -> ImplicitSolid:
        """Return the drawn model as one solid, whose origin is the canvas's point ``middle``.

        A canvas knows distances near its solids only; further away those of its voxels replace
        them.
        """
        middle = np.asarray(middle, dtype=float)
        low, counts = self.origin, np.array(self.field.shape)
        high = low + self.step * (counts - 1)
        away = scipy.ndimage.distance_transform_edt(self.field > 0, sampling=self.step)
        far = np.maximum(away - self.step, KNOWN_MM).astype(np.float32)
        lattice = np.where(self.field > KNOWN_MM, far, self.field)

        def distance(x: Field, y: Field, z: Field) -> Field:
            points = np.abs(x + middle[0]), y + middle[1], z + middle[2]
            places = [(p - o) / self.step for p, o in zip(points, low, strict=True)]
            at = np.broadcast_arrays(*places)
            return scipy.ndimage.map_coordinates(lattice, at, order=1, mode="nearest")

        # The first number is the place of the lattice, which the kernels' table sets.
        numbers = (0.0, *counts.tolist(), self.step, *low.tolist())
        box = np.array([-high[0], low[1], low[2]]) - middle, high - middle
        return ImplicitSolid(distance, *box, Form(LATTICE, np.eye(3), middle, numbers, lattice))
