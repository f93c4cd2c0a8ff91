"""Kernel of the forward model: line integrals along the rays of one view."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from twinct.recon._vector.brick import (
    ROOM,
    fits,
    fits_window,
    in_brick,
    in_pairs,
    in_volume,
    move,
    take_pairs,
)
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
    read_along,
    read_fours_along,
    read_guarded,
    read_pairs_along,
)
from twinct.recon._vector.options import CUBE, IMAGE, OPTIONS, RAYS, kernel
from twinct.recon._vector.windows import in_window, mostly_narrow

PLANES = 16
"""Planes of a slab; all rays of a tile go through one slab before the next."""


_sum_slab = slab_of(
    of_lattice(read_along, read_pairs_along, read_fours_along), read_guarded, in_window
)
"""Function that adds up the samples of the planes from start to end."""


@njit(**OPTIONS)
def _box(lanes, count, axis, shape, start, sums, marks):
    """Mark the groups that read nothing in a slab; return the box of all others.

    It has no planes behind the last slab.
    """
    end = min(start + PLANES, shape[2 - axis]) - 1
    if end < start:
        return start, 0, 0, 0, 0, 0
    mark(lanes, count, axis, shape, start, end, sums, marks)
    return box_of(lanes, count, axis, shape, start, end, marks)


@kernel(f"({CUBE}, {RAYS}, {IMAGE}, {IMAGE}, i4[:, :, ::1])")
def forward(x, view, out, lengths, sums):
    """Write the line integrals of ``x`` (z, y, x) in one view to ``out`` (rows, columns).

    Likewise the path lengths in the grid to ``lengths``, unless it is empty. ``sums`` says which
    blocks of ``x`` may be filled, see ``groups.mark``; the others hold zeros.
    """
    rows, columns = out.shape
    shape, flat = x.shape, x.reshape(-1)
    across = (columns + TILE_COLUMNS - 1) // TILE_COLUMNS
    for tile in prange((rows + TILE_ROWS - 1) // TILE_ROWS * across):
        top, left = tile // across * TILE_ROWS, tile % across * TILE_COLUMNS
        bottom, right = min(top + TILE_ROWS, rows), min(left + TILE_COLUMNS, columns)
        out[top:bottom, left:right] = 0.0
        scratch = room()
        blocks, ranges, pixels, steps, groups, _, edges, lines = scratch
        pairs, marks = np.empty(2 * ROOM, np.float32), np.empty((2, TILE_GROUPS), np.float32)
        load(view, shape, (top, bottom), (left, right), False, scratch, lengths)
        for axis in range(3):
            count = groups[axis]
            if count == 0:
                continue
            planes, rays, bounds = shape[2 - axis], blocks[axis], ranges[axis]
            lanes = edges[axis]
            middle = np.float32(0.5 * (planes - 1))
            here, there = marks[0, :count], marks[1, :count]
            box = _box(lanes, count, axis, shape, 0, sums, here)
            for start in range(0, planes, PLANES):
                end = min(start + PLANES, planes) - 1
                following = _box(lanes, count, axis, shape, start + PLANES, sums, there)
                if box[1] > 0:
                    told = start, end, rays, bounds, lanes, count, here
                    ahead = flat, shape, axis, following
                    if fits_window(box) and mostly_narrow(lanes, count, middle, start, end, here):
                        move(flat, shape, axis, box, lines, False)
                        _sum_slab(lines, in_brick(box, axis, shape), *told, True, ahead)
                    elif fits(box):
                        take_pairs(flat, shape, axis, box, lines, pairs)
                        _sum_slab(pairs, in_pairs(box, axis, shape), *told, False, ahead)
                    else:
                        _sum_slab(flat, in_volume(axis, shape), *told, False, ahead)
                box, here, there = following, there, here
            for slot in range(count * LANES):
                pixel = pixels[axis, slot]
                if pixel >= 0:
                    total = rays[slot // LANES * BLOCK + VALUE + slot % LANES]
                    out[pixel // 65536, pixel % 65536] = steps[axis, slot] * total
