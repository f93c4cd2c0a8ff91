"""Kernel of the exact adjoint of the forward model."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from twinct.recon._vector.brick import fits, in_brick, in_volume, move
from twinct.recon._vector.groups import (
    TILE_COLUMNS,
    TILE_GROUPS,
    TILE_ROWS,
    box_of,
    load,
    mark,
    of_lattice,
    room,
    slab_of,
)
from twinct.recon._vector.march import (
    BLOCK,
    LANES,
    VALUE,
    add_along,
    add_guarded,
    add_pairs_along,
)
from twinct.recon._vector.options import CUBE, IMAGE, OPTIONS, RAYS, kernel

PLANES = 16
"""Planes of a slab: a cache line of voxels along x."""


@njit(**OPTIONS)
def _weigh(y, rays, pixels, steps, groups):
    """Set the value of each ray to its measured value times its mm per plane."""
    for slot in range(groups * LANES):
        pixel = pixels[slot]
        if pixel >= 0:
            value = steps[slot] * y[pixel // 65536, pixel % 65536]
            rays[slot // LANES * BLOCK + VALUE + slot % LANES] = value


_add_slab = slab_of(of_lattice(add_along, add_pairs_along, add_pairs_along), add_guarded)
"""Function that adds the rays' values to the voxels of the planes from start to end."""


@kernel(f"({IMAGE}, {RAYS}, {CUBE}, i8)")
def adjoint(y, view, out, parts):
    """Add the exact transpose of ``forward`` applied to ``y`` (rows, columns) to ``out`` (z, y, x).

    Slabs of planes across the axis that a ray crosses fastest are divided into ``parts``, one for
    each thread, so that no two threads write to one voxel. The order of the sums does not depend on
    the number of parts.
    """
    rows, columns = y.shape
    shape, flat = out.shape, out.reshape(-1)
    no_lengths, all_filled = np.empty((0, 0), np.float32), np.empty((0, 0, 0), np.int32)
    for axis in range(3):
        planes = shape[2 - axis]
        slabs = (planes + PLANES - 1) // PLANES
        for part in prange(parts):
            scratch = room()
            rays, bounds = scratch[0][axis], scratch[1][axis]
            edges, brick = scratch[6][axis], scratch[7]
            marks = np.empty(TILE_GROUPS, np.float32)
            nothing = flat, shape, axis, (0, 0, 0, 0, 0, 0)
            own = slabs * part // parts, slabs * (part + 1) // parts
            for top in range(0, rows, TILE_ROWS):
                bottom = min(top + TILE_ROWS, rows)
                for left in range(0, columns, TILE_COLUMNS):
                    right = min(left + TILE_COLUMNS, columns)
                    load(view, shape, (top, bottom), (left, right), True, scratch, no_lengths)
                    groups = scratch[4][axis]
                    _weigh(y, rays, scratch[2][axis], scratch[3][axis], groups)
                    stop = min(own[1] * PLANES, planes) - 1
                    for slab in range(own[0], own[1]):
                        start, end = slab * PLANES, min((slab + 1) * PLANES - 1, stop)
                        mark(edges, groups, axis, shape, start, end, all_filled, marks)
                        box = box_of(edges, groups, axis, shape, start, end, marks)
                        if box[1] == 0:
                            continue
                        told = start, end, rays, bounds, edges, groups, marks, False, nothing
                        if fits(box):
                            move(flat, shape, axis, box, brick, False)
                            _add_slab(brick, in_brick(box, axis, shape), *told)
                            move(flat, shape, axis, box, brick, True)
                        else:
                            _add_slab(flat, in_volume(axis, shape), *told)
