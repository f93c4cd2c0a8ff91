"""Attenuation of metal, from the line integrals that metal adds to those of everything else.

The place of the metal is known roughly, from a first volume. A least-squares fit, whose unknowns
are the voxels there, finds the attenuation that the metal adds. A first volume alone shows too
little: its few iterations do not reach the steps at metal, and its edges are blurred.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.geometry import Floats, Pose, VolumeGrid
from twinct.recon.checks import Mask, mask_of
from twinct.recon.engine import Singles
from twinct.recon.projector import Projector

MOST_VIEWS = 60
"""Views of the fit, spread evenly over all: metal has few voxels and much contrast."""

ITERATIONS = 10
"""Steps of the fit."""

DAMPING = 0.7
"""Weight of the fit towards 0, as a share of the length of a voxel's column of the projector.

With 0.2, a ball of two voxels comes out 39 % too dense; each 0.2 more takes 2 % off large metal.
"""

MetalIntegrals = Callable[[int], NDArray[np.floating]]
"""Function of a view: line integrals of the metal's excess, (rows, columns), mm times 1/mm."""


def fitted_excess(
    A: Projector,
    metal: NDArray[np.bool_],
    integrals: MetalIntegrals,
    mask: Mask | None = None,
) -> tuple[NDArray[np.intp], Singles]:
    """Return the attenuation by which metal exceeds its surroundings, in the voxels around it.

    A damped fit by LSQR (Paige, Saunders, ACM Trans. Math. Softw. 8 (1982) 43) of the voxels of the
    metal and their neighbours, to the rays that meet them in at most ``MOST_VIEWS`` views.

    Args:
        A: the projector, with the believed geometry.
        metal: True in voxels that hold metal, (z, y, x); at least one.
        integrals: line integrals of the excess.
        mask: True where a pixel counts, (rows, columns) or (views, rows, columns).

    Returns:
        Flat indices of the metal's voxels and their neighbours in (z, y, x), and the excess there,
        1/mm, not negative.
    """
    near = scipy.ndimage.binary_dilation(metal)
    box = scipy.ndimage.find_objects(near.astype(np.uint8))[0]
    views = np.unique(np.linspace(0, len(A) - 1, min(len(A), MOST_VIEWS)).astype(int))
    part, free = Projector(A.geometry[views], _part(A.grid, box)), near[box]
    seen = part(free.astype(np.float32)) > 0
    for image, view in zip(seen, views, strict=True):
        image &= True if mask is None else mask_of(mask, int(view))

    def forward(x: Singles) -> Singles:
        volume = np.zeros(free.shape, dtype=np.float32)
        volume[free] = x
        return part(volume)[seen]

    def back(y: Singles) -> Singles:
        images = np.zeros(seen.shape, dtype=np.float32)
        images[seen] = y
        return part.T(images)[free]

    rays = np.concatenate([integrals(int(v))[hit] for v, hit in zip(views, seen, strict=True)])
    voxels = int(free.sum())
    signs = np.random.default_rng(0).choice(np.array([-1, 1], dtype=np.float32), voxels)
    column = np.linalg.norm(forward(signs)) / np.sqrt(voxels)  # Hutchinson's estimate
    fit = scipy.sparse.linalg.LinearOperator(
        (len(rays), voxels), forward, rmatvec=back, dtype=np.float32
    )
    damp = DAMPING * float(column)
    excess = scipy.sparse.linalg.lsqr(fit, rays, damp=damp, iter_lim=ITERATIONS)[0]
    return np.flatnonzero(near), np.maximum(excess, 0).astype(np.float32)


def _part(grid: VolumeGrid, box: tuple[slice, ...]) -> VolumeGrid:
    """Return the grid of some voxels of a grid."""
    middle: Floats = np.array([(s.start + s.stop - 1) / 2 for s in box[::-1]]) * grid.voxel
    moved = Pose(grid.first_voxel_mm + middle, Pose.identity().quat)
    shape = [s.stop - s.start for s in box]
    return VolumeGrid(shape, grid.voxel, grid.world_from_grid @ moved)
