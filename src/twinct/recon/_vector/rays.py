"""Rays through voxels, for the forward model and its adjoint.

The forward model is Joseph's: a ray is sampled once per plane of voxel centres along the axis that
it crosses fastest, bilinearly in the plane, and values extend over the outer half voxel. The axis
is chosen per ray. All kernels compute in voxel indices (x, y, z) and take one view as numbers (see
``projector``): the source, the first pixel and the steps from pixel to pixel.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from twinct.rays.joseph import within
from twinct.recon._vector.options import IMAGE, OPTIONS, RAYS, kernel

# The plain function, here with fast mathematics.
_narrow = njit(inline="always", **OPTIONS)(within.py_func)


@njit(inline="always", **OPTIONS)
def ray_of(view, row, column, nx, ny, nz):
    """Return the axis, sample line and range of planes of one ray.

    Returns:
        axis (0, 1, 2 for x, y, z); then, for each of the two other axes in the order (x, y, z), the
        coordinate in the middle plane and its slope per plane; first and last plane; mm per plane;
        path length in the grid, mm.
    """
    sx, sy, sz = view[0, 0], view[0, 1], view[0, 2]
    dx = view[1, 0] + row * view[3, 0] + column * view[2, 0] - sx
    dy = view[1, 1] + row * view[3, 1] + column * view[2, 1] - sy
    dz = view[1, 2] + row * view[3, 2] + column * view[2, 2] - sz
    mx, my, mz = dx * view[4, 0], dy * view[4, 1], dz * view[4, 2]
    length = np.sqrt(mx * mx + my * my + mz * mz)
    ax, ay, az = abs(dx), abs(dy), abs(dz)
    if ax >= ay and ax >= az:
        axis, s, d, n = 0, sx, dx, nx
        b, db, nb = sy, dy, ny
        c, dc, nc = sz, dz, nz
    elif ay >= az:
        axis, s, d, n = 1, sy, dy, ny
        b, db, nb = sx, dx, nx
        c, dc, nc = sz, dz, nz
    else:
        axis, s, d, n = 2, sz, dz, nz
        b, db, nb = sx, dx, nx
        c, dc, nc = sy, dy, ny
    middle = 0.5 * (n - 1)
    b_slope = db / d
    c_slope = dc / d
    b_middle = b + (middle - s) * b_slope
    c_middle = c + (middle - s) * c_slope
    lo, hi = -0.5 - middle, n - 0.5 - middle
    lo, hi = _narrow(lo, hi, b_middle, b_slope, nb)
    lo, hi = _narrow(lo, hi, c_middle, c_slope, nc)
    step = length / abs(d)
    inside = max(hi - lo, 0.0) * step
    first = max(int(np.ceil(lo + middle)), 0)
    last = min(int(np.floor(hi + middle)), n - 1)
    if hi < lo:
        last = first - 1
    return axis, b_middle, b_slope, c_middle, c_slope, first, last, step, inside


@kernel(f"({RAYS}, UniTuple(i8, 3), {IMAGE})")
def chords(view, shape, out):
    """Write the path length of each ray in the grid, mm, to ``out`` (rows, columns)."""
    nz, ny, nx = shape
    rows, columns = out.shape
    for row in prange(rows):
        for column in range(columns):
            out[row, column] = ray_of(view, row, column, nx, ny, nz)[8]
