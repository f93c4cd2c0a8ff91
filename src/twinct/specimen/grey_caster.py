"""Line integrals of grey fields: the amount of each basis material along each ray."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import Panel, ScanGeometry
from twinct.specimen.grey import GreyField


class GreyCaster:
    """Rays through the voxels of a grey field, by Joseph's method as in ``recon.Projector``.

    Rays begin at the source and end at the pixel's centre. The outermost voxels extend over their
    outer half, and nothing is outside. In a sharp field, rays find the places where materials meet.
    """

    def __init__(self, field: GreyField, panel: Panel) -> None:
        """Take a field, which is not copied, and the panel of every view."""
        self.field, self.panel = field, panel
        self.show(field.amounts)

    def show(self, amounts: NDArray[np.float32]) -> None:
        """Take other amounts of the same shape, such as those of a moved body."""
        self._flat = amounts.reshape(-1).view()
        self._flat.setflags(write=False)  # one type for numba

    def cast(self, view: ScanGeometry) -> NDArray[np.float32]:
        """Return the integral of each amount along each ray, (materials, rows, columns), mm.

        Args:
            view: exactly one view, in the specimen's frame; the pixels are those of ``panel``.
        """
        out = np.zeros((len(self.field.materials), *self.panel.shape), np.float32)
        self.add(view, range(len(out)), out)
        return out

    def add(self, view: ScanGeometry, into: Sequence[int], out: NDArray[np.float32]) -> None:
        """Add the integral of each amount along each ray.

        Args:
            view: exactly one view, in the specimen's frame; the pixels are those of ``panel``.
            into: image of each basis material.
            out: receives the integrals, (images, rows, columns), mm.
        """
        grid, panel = self.field.grid, self.panel
        local = grid.world_from_grid.inverse()
        column, row = panel.first_pixel_mm
        u, v = view.u[0], view.v[0]
        first = view.detector[0] + column * u + row * v
        points = local.apply(np.stack([view.source[0], first])) - grid.first_voxel_mm
        steps = local.rotate(np.stack([panel.pitch_u * u, panel.pitch_v * v]))
        rays = np.vstack([np.vstack([points, steps]) / grid.voxel, grid.voxel])
        count, images = len(self.field.materials), np.array(into, np.int64)
        if self.field.sharp:
            from twinct.specimen._sharp_rays import add_lengths as add_amounts
        else:
            from twinct.specimen._grey_rays import add_amounts
        add_amounts(self._flat, grid.shape, count, rays, images, out)
