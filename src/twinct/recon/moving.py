"""Compensation of a known motion: projections of a body that deforms from view to view.

The volume is the body in its reference state. View i sees it deformed: A_i W_i x, where W_i reads x
at the place where a voxel's material was. The adjoint is exact, sum_i W_i^T A_i^T y_i. An update of
SART and voxel-driven back projections go through the world: a voxel of the reference state takes
what its material received. Interpolation is trilinear, on a coarse map of the displacements.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.core.errors import InputError
from twinct.geometry import Floats, ScanGeometry, VolumeGrid
from twinct.recon.engine import Singles, requested_engine
from twinct.recon.projector import LOWEST, Projector, readable, writable
from twinct.specimen.displacement_map import Deforming, Map, map_of, step_of


class Moved:
    """A deformation on a grid: reads volumes of the reference state, and the reverse."""

    def __init__(self, deformation: Deforming, grid: VolumeGrid) -> None:
        """Take the deformation; its maps are computed at their first use."""
        self.deformation, self.grid = deformation, grid

    @cached_property
    def _to(self) -> Map:
        return map_of(self.deformation, self.grid, "to_reference")

    @cached_property
    def _from(self) -> Map:
        return map_of(self.deformation, self.grid, "from_reference")

    def add_deformed(self, x: Singles, out: Singles, floor: float = LOWEST) -> None:
        """Add the deformed body of a volume ``x`` of the reference state to ``out``."""
        _kernels().add_pulled(x, *self._to, np.float32(floor), out)

    def add_adjoint(self, y: Singles, out: Singles) -> None:
        """Add the exact adjoint of ``add_deformed``, applied to ``y``, to ``out``."""
        _kernels().add_pushed(y, *self._to, self._to.layers, out)

    def add_undeformed(self, y: Singles, out: Singles, floor: float = LOWEST) -> None:
        """Add a volume ``y`` of the deformed body, in its reference state, to ``out``.

        ``out`` is then raised to ``floor``.
        """
        _kernels().add_pulled(y, *self._from, np.float32(floor), out)


def _kernels() -> Any:
    """Return the kernels, which load numba: only where they are needed."""
    return import_module("twinct.recon.moving_kernels")


def refuse_card() -> None:
    """Raise InputError: the engine cuda does not compensate motion."""
    raise InputError("the engine cuda does not compensate motion; use vector (unset TWINCT_ENGINE)")


def moving_bytes(grid: VolumeGrid, views: int) -> int:
    """Return the bytes that a moving projector holds: two volumes, and both maps of each view."""
    voxels = math.prod(grid.shape)
    return int(4 * MovingProjector.own_volumes * voxels + 24 * views * voxels / step_of(grid) ** 3)


class MovingProjector(Projector):
    """Linear operator from a body's reference state to its projections while it moves.

    Attributes:
        motion: deformation of the body in each view.
    """

    own_volumes = 2.0
    leaves_out = False

    def __init__(
        self,
        geometry: ScanGeometry,
        grid: VolumeGrid,
        motion: Sequence[Deforming],
        engine: str | None = None,
    ) -> None:
        """Take one deformation for each view; views that share one are computed together.

        Raises:
            InputError: as for ``Projector``; the engine is cuda; or the numbers of views and
                deformations differ.
        """
        super().__init__(geometry, grid, engine)
        if requested_engine(engine) == "cuda":
            refuse_card()
        if len(motion) != len(geometry):
            raise InputError(
                f"there are {len(motion)} deformations for {len(geometry)} views; each view needs "
                "one"
            )
        self.motion: tuple[Deforming, ...] = tuple(motion)
        self._moved = {id(one): Moved(one, grid) for one in self.motion}

    def _groups(self) -> list[tuple[Moved, list[int]]]:
        """Return each deformation with its views."""
        views: dict[int, list[int]] = {}
        for view, one in enumerate(self.motion):
            views.setdefault(id(one), []).append(view)
        return [(self._moved[key], there) for key, there in views.items()]

    def __call__(self, x: ArrayLike, out: Singles | None = None) -> Singles:
        """Return the line integrals of the body ``x`` in its state at each view."""
        x = readable(x, self.domain_shape, "the volume")
        y, there = writable(out, self.range_shape), np.empty_like(x)
        for moved, views in self._groups():
            there[:] = 0.0
            moved.add_deformed(x, there)
            for view in views:
                self.kernels.forward(there, self.index_rays[view], y[view])
        return y

    def T(self, y: ArrayLike, out: Singles | None = None) -> Singles:  # noqa: N802 - its usual name
        """Return the exact adjoint of ``y`` (views, rows, columns), (z, y, x), as in Projector."""
        y = readable(y, self.range_shape, "the projections")
        x = writable(out, self.domain_shape)
        x[:], there = 0.0, np.empty_like(x)
        for moved, views in self._groups():
            there[:] = 0.0
            for view in views:
                self.kernels.adjoint(y[view], self.index_rays[view], there)
            moved.add_adjoint(there, x)
        return x

    def __getitem__(self, views: Any) -> MovingProjector:
        """Return the operator of some views, as in Projector."""
        part = super().__getitem__(views)
        assert isinstance(part, MovingProjector)
        numbers: list[int] = np.atleast_1d(np.arange(len(self))[views]).tolist()
        part.motion = tuple(self.motion[view] for view in numbers)
        return part

    def on(self, grid: VolumeGrid, geometry: ScanGeometry | None = None) -> MovingProjector:
        """Return the operator of another grid and, if given, as many other views."""
        return MovingProjector(geometry or self.geometry, grid, self.motion, self.engine)

    def update(
        self,
        x: Singles,
        view: int,
        measured: Singles,
        *,
        relaxation: float,
        mask: NDArray[np.bool_] | None = None,
        floor: float = LOWEST,
        change: Singles | None = None,
        seen: Singles | None = None,
    ) -> tuple[Singles, Singles]:
        """Apply SART's update from one view, as in Projector: B goes to the moved voxels."""
        moved = self._moved[id(self.motion[view])]
        there, rise = np.zeros_like(x), np.zeros_like(x)
        moved.add_deformed(x, there)
        looked = None if seen is None else np.zeros_like(x)
        images = super().update(
            there, view, measured, relaxation=relaxation, mask=mask, change=rise, seen=looked
        )
        moved.add_undeformed(rise, x if change is None else change, floor)
        if seen is not None and looked is not None:
            moved.add_undeformed(looked, seen)
        return images

    def line_integrals_of(self, x: Singles, view: int) -> tuple[Singles, Singles]:
        """Return A x of one view and its path lengths, as in Projector."""
        there = np.zeros(self.domain_shape, np.float32)
        self._moved[id(self.motion[view])].add_deformed(x, there)
        return super().line_integrals_of(there, view)

    def add_image(self, image: Singles, view: int, out: Singles) -> None:
        """Add B of one view's image to a volume, as in Projector: B goes to the moved voxels."""
        there = np.zeros(self.domain_shape, np.float32)
        super().add_image(image, view, there)
        self._moved[id(self.motion[view])].add_undeformed(there, out)

    def back_project(self, images: Singles, scales: Floats, out: Singles) -> None:
        """Add each view's image values at the projections of the moved voxels, as in Projector."""
        for moved, views in self._groups():
            there = np.zeros_like(out)
            chosen = np.ascontiguousarray(images[views])
            self.kernels.back_project(chosen, self._pixels[views], scales[views], there)
            moved.add_undeformed(there, out)
