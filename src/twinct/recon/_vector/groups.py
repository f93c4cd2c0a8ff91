"""Rays sorted by the axis that they cross fastest, in groups for ``march``."""

from __future__ import annotations

import numpy as np
from numba import njit

from twinct.recon._vector import vectors
from twinct.recon._vector.brick import ROOM, look_ahead
from twinct.recon._vector.march import B_MIDDLE, BLOCK, C_MIDDLE, LANES, VALUE
from twinct.recon._vector.options import OPTIONS
from twinct.recon._vector.rays import ray_of
from twinct.recon.blocks import EDGE

TILE_ROWS = 32
TILE_COLUMNS = 64
"""Rays of a tile, which go through the volume together so that voxels are read only once."""

CELL = 4
"""Rows and columns of the rays of a group, if they are neighbours."""

TILE_GROUPS = TILE_ROWS * (TILE_COLUMNS // LANES)
"""Largest number of groups of one axis in a tile; no group reaches beyond its row or its cell."""

EDGES = 10
"""Number of values for a group's edges.

The values are first and last plane, then position and slope of two lines along b (see ``_edge``),
and of two along c.
"""

FAR = np.float32(1e9)
"""Mark of a group that reads nothing."""

_MARGIN = 1e-2
"""Distance of unguarded samples from the border, in voxels; float32 rounding is far smaller."""


@njit(**OPTIONS)
def room():
    """Allocate scratch arrays for a tile: the output of ``load``, one row of rays, and a brick."""
    groups = TILE_GROUPS
    return (
        np.empty((3, groups * BLOCK), np.float32),
        np.empty((3, groups, 4), np.int64),
        np.empty((3, groups * LANES), np.int64),
        np.empty((3, groups * LANES), np.float32),
        np.zeros(3, np.int64),
        np.empty((3, TILE_COLUMNS, 8), np.float64),
        np.empty((3, EDGES, groups), np.float32),
        np.empty(ROOM, np.float32),
    )


@njit(inline="always", **OPTIONS)
def cells_of(axis, shape):
    """Return the numbers of cells between voxel centres along b and c.

    These are the other axes in the order x, y, z.
    """
    nz, ny, nx = shape
    return (ny if axis == 0 else nx) - 1, (ny if axis == 2 else nz) - 1


@njit(inline="always", **OPTIONS)
def _clear(lo, hi, at_middle, slope, middle, cells):
    """Return the part of lo <= n <= hi where at_middle + (n - middle) slope is within margins."""
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


@njit(inline="always", **OPTIONS)
def _edge(block, kind, near, far, edge):
    """Write two straight lines that enclose a group's rays between two planes.

    Planes count from the middle. The lowest position among straight lines is a concave function of
    the plane, never below the line between its ends; the highest position is convex and never
    above. A line is stored as its position in the middle plane and its slope.
    """
    low = high = block[kind] + near * block[kind + LANES]
    low_far = high_far = block[kind] + far * block[kind + LANES]
    for lane in range(1, LANES):
        at, slope = block[kind + lane], block[kind + LANES + lane]
        low, high = min(low, at + near * slope), max(high, at + near * slope)
        low_far, high_far = min(low_far, at + far * slope), max(high_far, at + far * slope)
    length = max(far - near, 1.0)
    edge[1], edge[3] = (low_far - low) / length, (high_far - high) / length
    edge[0], edge[2] = low - near * edge[1], high - near * edge[3]


@njit(**OPTIONS)
def load(view, shape, rows, columns, apart, room, lengths):
    """Sort the rays of a tile by axis, without the rays that miss the volume.

    ``rows`` and ``columns`` are half-open ranges. The rays of a group are a cell of ``CELL`` x
    ``CELL`` neighbours or, if ``apart``, lie in one row so far from each other that they share no
    voxels. ``room`` receives, for each axis: blocks with value 0; ranges, the first and last plane
    that any ray of a group crosses and the first and last plane in which all rays are clear of the
    border; pixels (row * 65536 + column, -1 for an empty lane); mm per plane; the number of groups;
    and the groups' edges, see ``_edge``. ``lengths``, (rows, columns), receives path lengths in the
    grid unless it is empty.
    """
    groups, found = room[4], room[5]
    nz, ny, nx = shape
    groups[:] = 0
    counts = np.zeros(3, np.int64)
    height, width = (1, TILE_COLUMNS) if apart else (CELL, CELL)
    for top in range(rows[0], rows[1], height):
        for left in range(columns[0], columns[1], width):
            counts[:] = 0
            for row in range(top, min(top + height, rows[1])):
                for column in range(left, min(left + width, columns[1])):
                    axis, b_middle, b_slope, c_middle, c_slope, first, last, step, inside = ray_of(
                        view, row, column, nx, ny, nz
                    )
                    if len(lengths) > 0:
                        lengths[row, column] = inside
                    if first <= last:
                        ray = found[axis, counts[axis]]
                        ray[0], ray[1], ray[2], ray[3] = b_middle, b_slope, c_middle, c_slope
                        ray[4], ray[5], ray[6], ray[7] = first, last, step, row * 65536 + column
                        counts[axis] += 1
            for axis in range(3):
                here = (counts[axis] + LANES - 1) // LANES
                for q in range(here):
                    first, stride = (q, here) if apart else (q * LANES, 1)
                    _group(axis, shape, found[axis, : counts[axis]], first, stride, room)


@njit(**OPTIONS)
def _group(axis, shape, found, first, stride, room):
    """Add a group of the rays ``found`` from the first one in steps, see ``load``."""
    blocks, ranges, pixels, steps, groups, _, edges, _ = room
    group = groups[axis]
    b_cells, c_cells = cells_of(axis, shape)
    middle = 0.5 * (shape[2 - axis] - 1)
    near, far, lo, hi = 1e9, -1e9, -1e9, 1e9
    for lane in range(LANES):
        n = first + lane * stride
        ray = found[min(n, len(found) - 1)]
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
        pixels[axis, slot] = int(ray[7]) if n < len(found) else -1
    ranges[axis, group, 0], ranges[axis, group, 1] = int(near), int(far)
    ranges[axis, group, 2] = int(np.ceil(lo))
    ranges[axis, group, 3] = int(np.floor(hi))
    edges[axis, 0, group], edges[axis, 1, group] = near, far
    block = blocks[axis, group * BLOCK : (group + 1) * BLOCK]
    _edge(block, B_MIDDLE, near - middle, far - middle, edges[axis, 2:6, group])
    _edge(block, C_MIDDLE, near - middle, far - middle, edges[axis, 6:10, group])
    groups[axis] += 1


@njit(inline="always", **OPTIONS)
def _block(place):
    """Return the block of voxels in which a place along an axis lies."""
    return int(max(place, np.float32(0.0))) // EDGE


@njit(inline="always", **OPTIONS)
def _in_order(place, axis):
    """Return numbers along the axis, b and c in the order z, y, x."""
    along, b, c = place
    if axis == 0:
        return c, b, along
    return (c, along, b) if axis == 1 else (along, c, b)


@njit(**OPTIONS)
def _filled(edges, group, axis, first, last, middle, sums):
    """Return True if a block that a group reads in the planes first to last may be filled.

    ``sums`` are those of ``blocks.Blocks``.
    """
    m, n = first - middle, last - middle
    low, high = edges[2, group], edges[4, group]
    b_low = min(low + m * edges[3, group], low + n * edges[3, group])
    b_high = max(high + m * edges[5, group], high + n * edges[5, group])
    low, high = edges[6, group], edges[8, group]
    c_low = min(low + m * edges[7, group], low + n * edges[7, group])
    c_high = max(high + m * edges[9, group], high + n * edges[9, group])
    slack = np.float32(0.5)  # of rounding errors
    begin = _block(first), _block(b_low - slack), _block(c_low - slack)
    # The highest sample also reads the next voxel.
    beside = np.float32(1.5)
    end = _block(last) + 1, _block(b_high + beside) + 1, _block(c_high + beside) + 1
    (z0, y0, x0), (z1, y1, x1) = _in_order(begin, axis), _in_order(end, axis)
    nz, ny, nx = sums.shape
    z0, y0, x0 = min(z0, nz - 1), min(y0, ny - 1), min(x0, nx - 1)
    z1, y1, x1 = min(z1, nz - 1), min(y1, ny - 1), min(x1, nx - 1)
    above = sums[z1, y1, x1] - sums[z1, y1, x0] - sums[z1, y0, x1] + sums[z1, y0, x0]
    return above > sums[z0, y1, x1] - sums[z0, y1, x0] - sums[z0, y0, x1] + sums[z0, y0, x0]


@njit(**OPTIONS)
def mark(edges, groups, axis, shape, start, end, sums, marks):
    """Set the marks of groups that read nothing in planes start to end to ``FAR``, others to 0.

    Blocks that are not filled hold nothing; if ``sums`` is empty, all are filled.
    """
    middle = np.float32(0.5 * (shape[2 - axis] - 1))
    begin, stop = np.float32(start), np.float32(end)
    for group in range(groups):
        first, last = max(edges[0, group], begin), min(edges[1, group], stop)
        marks[group] = FAR if first > last else np.float32(0.0)
    if len(sums) == 0:
        return
    for group in range(groups):
        if marks[group] == 0:
            first, last = max(edges[0, group], begin), min(edges[1, group], stop)
            if not _filled(edges, group, axis, first, last, middle, sums):
                marks[group] = FAR


@njit(**OPTIONS)
def box_of(edges, groups, axis, shape, start, end, marks):
    """Return the box of voxels (see ``brick``) that the groups read in planes start to end.

    It has no planes if all groups have the mark ``FAR``, see ``mark``.
    """
    b_cells, c_cells = cells_of(axis, shape)
    middle = np.float32(0.5 * (shape[2 - axis] - 1))
    begin, stop = np.float32(start), np.float32(end)
    b_low, b_high, c_low, c_high = FAR, -FAR, FAR, -FAR
    for group in range(groups):
        first, last = max(edges[0, group], begin), min(edges[1, group], stop)
        m, n = first - middle, last - middle
        apart = marks[group]  # excludes groups that read nothing
        at, slope = edges[2, group] + apart, edges[3, group]
        b_low = min(b_low, at + m * slope, at + n * slope)
        at, slope = edges[4, group] - apart, edges[5, group]
        b_high = max(b_high, at + m * slope, at + n * slope)
        at, slope = edges[6, group] + apart, edges[7, group]
        c_low = min(c_low, at + m * slope, at + n * slope)
        at, slope = edges[8, group] - apart, edges[9, group]
        c_high = max(c_high, at + m * slope, at + n * slope)
    if b_low > b_high:
        return start, 0, 0, 0, 0, 0
    b0, c0 = _below(b_low, b_cells), _below(c_low, c_cells)
    # The cell of the highest sample, and one more against rounding errors.
    nb = min(int(max(b_high, np.float32(0.0))) + 2, b_cells) - b0 + 1
    nc = min(int(max(c_high, np.float32(0.0))) + 2, c_cells) - c0 + 1
    # Multiples of eight are copied faster.
    whole = (nb + vectors.LANES - 1) // vectors.LANES * vectors.LANES
    nb = min(whole, b_cells + 1 - b0)
    return start, end - start + 1, c0, nc, b0, nb


@njit(inline="always", **OPTIONS)
def _below(lowest, cells):
    return min(max(int(max(lowest, np.float32(0.0))) - 1, 0), cells - 1)


def of_lattice(along, pairs_along, fours_along):
    """Build a function of ``march`` that chooses one of these by the lattice."""

    @njit(**OPTIONS)
    def inside(x, rays, block, first, last, lattice):
        if lattice[9] == 1:
            fours_along(x, rays, block, first, last, lattice)
        elif lattice[6] == 1:
            pairs_along(x, rays, block, first, last, lattice)
        else:
            along(x, rays, block, first, last, lattice)

    return inside


def slab_of(inside, guarded, in_window=None):
    """Build a function that takes groups through the planes of a slab, with functions of ``march``.

    The function leaves out the groups with the mark ``FAR``. ``in_window`` takes a group through
    planes and returns True, or returns False; it is tried if ``windows`` is true. ``ahead`` is the
    volume, its shape, the axis and the box of the following slab, see ``look_ahead``.
    """
    try_window = in_window or _in_no_window

    @njit(**OPTIONS)
    def slab(x, lattice, start, end, rays, ranges, edges, groups, marks, windows, ahead):
        volume, shape, axis, box = ahead
        for group in range(groups):
            look_ahead(volume, shape, axis, box, group, groups)
            if marks[group] > 0:
                continue
            bounds, block = ranges[group], group * BLOCK
            first, last = max(start, bounds[0]), min(end, bounds[1])
            if first > last:
                continue
            # The planes in which all rays are clear of the border.
            lo, hi = max(first, bounds[2]), min(last, bounds[3])
            if lo > hi:
                lo, hi = last + 1, last
            if first < lo:
                guarded(x, rays, block, first, lo - 1, lattice)
            if not (windows and try_window(x, rays, block, lo, hi, lattice, edges, group)):
                inside(x, rays, block, lo, hi, lattice)
            if hi < last:
                guarded(x, rays, block, hi + 1, last, lattice)

    return slab


@njit(inline="always", **OPTIONS)
def _in_no_window(x, rays, block, first, last, lattice, edges, group):
    return False
