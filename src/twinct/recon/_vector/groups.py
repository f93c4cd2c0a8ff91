"""Rays sorted by the axis they cross fastest, in groups of eight, as ``march`` takes them."""

from __future__ import annotations

import numpy as np
from numba import njit

from twinct.recon._vector.brick import ROOM
from twinct.recon._vector.march import (
    B_MIDDLE,
    B_SLOPE,
    BLOCK,
    C_MIDDLE,
    C_SLOPE,
    FIRST,
    LAST,
    VALUE,
)
from twinct.recon._vector.options import OPTIONS
from twinct.recon._vector.rays import ray_of
from twinct.recon._vector.vectors import LANES

TILE_ROWS = 16
TILE_COLUMNS = 64
"""Rays of a tile: they go through the volume together, so that voxels are read once from memory."""

TILE_GROUPS = TILE_ROWS * (TILE_COLUMNS // LANES)
"""Groups of one axis that a tile can have; none reaches beyond its row."""

_MARGIN = 1e-2
"""Voxels by which unguarded samples keep away from the border: float32 rounding is far smaller."""


@njit(**OPTIONS)
def room():
    """Scratch arrays for a tile: what ``load`` fills, one row of rays, and a brick."""
    groups = TILE_GROUPS
    return (
        np.empty((3, groups * BLOCK), np.float32),
        np.empty((3, groups, 4), np.int64),
        np.empty((3, groups * LANES), np.int64),
        np.empty((3, groups * LANES), np.float32),
        np.zeros(3, np.int64),
        np.empty((3, TILE_COLUMNS, 8), np.float64),
        np.empty(ROOM, np.float32),
    )


@njit(inline="always", **OPTIONS)
def cells_of(axis, shape):
    """Cells between voxel centres in a plane along b and c, the other axes in the order x, y, z."""
    nz, ny, nx = shape
    return (ny if axis == 0 else nx) - 1, (ny if axis == 2 else nz) - 1


@njit(inline="always", **OPTIONS)
def _clear(lo, hi, at_middle, slope, middle, cells):
    """Part of lo <= n <= hi where at_middle + (n - middle) slope is inside by the margin."""
    below = _MARGIN - at_middle
    above = cells - _MARGIN - at_middle
    if slope > 1e-9:
        lo = max(lo, middle + below / slope)
        hi = min(hi, middle + above / slope)
    elif slope < -1e-9:
        lo = max(lo, middle + above / slope)
        hi = min(hi, middle + below / slope)
    elif below > 0.0 or above < 0.0:
        hi = lo - 1.0
    return lo, hi


@njit(**OPTIONS)
def load(view, shape, rows, columns, apart, room):
    """Sort the rays of a tile; rays that miss the volume are left out.

    ``rows`` and ``columns`` are the first and the one after the last. The rays of a group are
    neighbours in their row or, if ``apart``, so far from each other that they share no voxels.
    ``room`` receives, for each axis: blocks with value 0; ranges, the first and last plane that any
    ray of a group crosses and the first and last in which all are clear of the border; pixels
    (row * 65536 + column, -1 where a lane is empty); mm per plane; and the number of groups.
    """
    blocks, ranges, pixels, steps, groups, found, _ = room
    nz, ny, nx = shape
    groups[:] = 0
    counts = np.zeros(3, np.int64)
    for row in range(rows[0], rows[1]):
        counts[:] = 0
        for column in range(columns[0], columns[1]):
            axis, b_middle, b_slope, c_middle, c_slope, first, last, step, _ = ray_of(
                view, row, column, nx, ny, nz
            )
            if first <= last:
                ray = found[axis, counts[axis]]
                ray[0], ray[1], ray[2], ray[3] = b_middle, b_slope, c_middle, c_slope
                ray[4], ray[5], ray[6], ray[7] = first, last, step, column
                counts[axis] += 1
        for axis in range(3):
            count = counts[axis]
            here = (count + LANES - 1) // LANES
            b_cells, c_cells = cells_of(axis, shape)
            middle = 0.5 * (shape[2 - axis] - 1)
            for q in range(here):
                group = groups[axis] + q
                near, far, lo, hi = 1e9, -1e9, -1e9, 1e9
                for lane in range(LANES):
                    n = lane * here + q if apart else q * LANES + lane
                    ray = found[axis, min(n, count - 1)]
                    at = group * BLOCK + lane
                    for kind in range(6):  # from B_MIDDLE to LAST
                        blocks[axis, at + kind * LANES] = ray[kind]
                    blocks[axis, at + VALUE] = 0.0
                    near, far = min(near, ray[4]), max(far, ray[5])
                    lo, hi = max(lo, ray[4]), min(hi, ray[5])
                    lo, hi = _clear(lo, hi, ray[0], ray[1], middle, b_cells)
                    lo, hi = _clear(lo, hi, ray[2], ray[3], middle, c_cells)
                    slot = group * LANES + lane
                    steps[axis, slot] = ray[6]
                    pixels[axis, slot] = row * 65536 + int(ray[7]) if n < count else -1
                ranges[axis, group, 0], ranges[axis, group, 1] = int(near), int(far)
                ranges[axis, group, 2] = int(np.ceil(lo))
                ranges[axis, group, 3] = int(np.floor(hi))
            groups[axis] += here


@njit(**OPTIONS)
def box_of(rays, ranges, groups, axis, shape, start, end):
    """The box of voxels (see ``brick``) that the groups read in the planes from start to end.

    It has no planes where they read none.
    """
    b_cells, c_cells = cells_of(axis, shape)
    middle = np.float32(0.5 * (shape[2 - axis] - 1))
    far = np.float32(1e9)
    b_low, b_high, c_low, c_high = far, -far, far, -far
    for group in range(groups):
        if ranges[group, 0] > end or ranges[group, 1] < start:
            continue
        at = group * BLOCK
        for lane in range(LANES):
            first = max(rays[at + FIRST + lane], np.float32(start))
            last = min(rays[at + LAST + lane], np.float32(end))
            if first <= last:
                b, b_slope = rays[at + B_MIDDLE + lane], rays[at + B_SLOPE + lane]
                c, c_slope = rays[at + C_MIDDLE + lane], rays[at + C_SLOPE + lane]
                b_first, b_last = b + (first - middle) * b_slope, b + (last - middle) * b_slope
                c_first, c_last = c + (first - middle) * c_slope, c + (last - middle) * c_slope
                b_low, b_high = min(b_low, b_first, b_last), max(b_high, b_first, b_last)
                c_low, c_high = min(c_low, c_first, c_last), max(c_high, c_first, c_last)
    if b_low > b_high:
        return start, 0, 0, 0, 0, 0
    b0, c0 = _below(b_low, b_cells), _below(c_low, c_cells)
    # The cell of the highest sample, and one more against rounding.
    nb = min(int(max(b_high, np.float32(0.0))) + 2, b_cells) - b0 + 1
    nc = min(int(max(c_high, np.float32(0.0))) + 2, c_cells) - c0 + 1
    if axis == 0:
        # Whole eights are copied faster.
        nb = min((nb + LANES - 1) // LANES * LANES, b_cells + 1 - b0)
    return start, end - start + 1, c0, nc, b0, nb


@njit(inline="always", **OPTIONS)
def _below(lowest, cells):
    return min(max(int(max(lowest, np.float32(0.0))) - 1, 0), cells - 1)


def slab_of(along, pairs_along, guarded):
    """Takes groups through the planes of a slab, from start to end, by functions of ``march``."""

    @njit(**OPTIONS)
    def slab(x, lattice, start, end, rays, ranges, groups):
        for group in range(groups):
            bounds, block = ranges[group], group * BLOCK
            first, last = max(start, bounds[0]), min(end, bounds[1])
            if first > last:
                continue
            # Those in which all rays are clear of the border.
            lo, hi = max(first, bounds[2]), min(last, bounds[3])
            if lo > hi:
                lo, hi = last + 1, last
            guarded(x, rays, block, first, lo - 1, lattice)
            if lattice[6] == 1:
                pairs_along(x, rays, block, lo, hi, lattice)
            else:
                along(x, rays, block, lo, hi, lattice)
            guarded(x, rays, block, hi + 1, last, lattice)

    return slab
