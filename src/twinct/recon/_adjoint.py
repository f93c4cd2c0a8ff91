"""Kernel of the exact adjoint of the forward model."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from twinct.recon._rays import OPTIONS, cell, ray_of

SLABS = 16
"""Slabs of the volume, each owned by one thread."""


@njit(parallel=True, **OPTIONS)
def adjoint(y, view, out):
    """Add the exact transpose of ``forward`` applied to ``y`` (rows, columns) to ``out`` (z, y, x).

    Each slab of the volume along z is owned by one thread, which runs through all rays.
    """
    nz, ny, nx = out.shape
    rows, columns = y.shape
    thickness = (nz + SLABS - 1) // SLABS
    for slab in prange(SLABS):
        bottom, top = slab * thickness, min((slab + 1) * thickness, nz)
        for row in range(rows):
            for column in range(columns):
                ray = ray_of(view, row, column, nx, ny, nz)
                axis, first, last = ray[0], ray[5], ray[6]
                weight = np.float32(ray[7]) * y[row, column]
                b_middle, b_slope = np.float32(ray[1]), np.float32(ray[2])
                c_middle, c_slope = np.float32(ray[3]), np.float32(ray[4])
                if axis == 2:
                    first, last = max(first, bottom), min(last, top - 1)
                    middle = np.float32(0.5 * (nz - 1))
                    for k in range(first, last + 1):
                        m = np.float32(k) - middle
                        i, f = cell(b_middle, b_slope, m, np.float32(nx - 2))
                        j, g = cell(c_middle, c_slope, m, np.float32(ny - 2))
                        low, high = weight * (np.float32(1.0) - g), weight * g
                        out[k, j, i] += low * (np.float32(1.0) - f)
                        out[k, j, i + 1] += low * f
                        out[k, j + 1, i] += high * (np.float32(1.0) - f)
                        out[k, j + 1, i + 1] += high * f
                    continue
                n = nx if axis == 0 else ny
                middle = np.float32(0.5 * (n - 1))
                # Planes where the ray can touch the slab: its lower neighbour lies in
                # [bottom - 1, top). One plane more at either end covers rounding; the border is
                # held, so it has no limit.
                lowest = bottom - 1.0 if bottom > 0 else -1.0
                highest = float(top) if top < nz else nz
                if abs(ray[4]) > 1e-6:
                    one = (lowest - ray[3]) / ray[4] + 0.5 * (n - 1)
                    two = (highest - ray[3]) / ray[4] + 0.5 * (n - 1)
                    near, far = min(one, two) - 1.0, max(one, two) + 1.0
                    first = max(first, int(min(max(near, 0.0), float(n))))
                    last = min(last, int(max(min(far, float(n)), -1.0)) + 1)
                for q in range(first, last + 1):
                    m = np.float32(q) - middle
                    k, g = cell(c_middle, c_slope, m, np.float32(nz - 2))
                    if k + 1 < bottom or k >= top:
                        continue
                    low, high = weight * (np.float32(1.0) - g), weight * g
                    if axis == 0:
                        j, f = cell(b_middle, b_slope, m, np.float32(ny - 2))
                        if k >= bottom:
                            out[k, j, q] += low * (np.float32(1.0) - f)
                            out[k, j + 1, q] += low * f
                        if k + 1 < top:
                            out[k + 1, j, q] += high * (np.float32(1.0) - f)
                            out[k + 1, j + 1, q] += high * f
                    else:
                        i, f = cell(b_middle, b_slope, m, np.float32(nx - 2))
                        if k >= bottom:
                            out[k, q, i] += low * (np.float32(1.0) - f)
                            out[k, q, i + 1] += low * f
                        if k + 1 < top:
                            out[k + 1, q, i] += high * (np.float32(1.0) - f)
                            out[k + 1, q, i + 1] += high * f
