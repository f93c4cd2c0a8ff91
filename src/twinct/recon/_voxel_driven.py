"""Kernel of FDK: distance-weighted, voxel-driven back projection of filtered images."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from twinct.recon._rays import OPTIONS


@njit(parallel=True, **OPTIONS)
def back_project(images, matrices, scales, out):
    """Add scale / depth^2 times what each image holds where a voxel projects to ``out`` (z, y, x).

    Bilinear between pixel centres; border pixels are held over their outer half, beside the panel
    there is nothing. A voxel takes the views in their order: threads do not change the last bit.

    Args:
        images: (views, rows, columns).
        matrices: (views, 3, 4) float64: voxel index (i, j, k, 1) to (column, row, 1) times depth.
        scales: (views,), mm^2.
        out: changed in place.
    """
    nz, ny, nx = out.shape
    views, rows, columns = images.shape
    half, zero = np.float32(0.5), np.float32(0.0)
    last_column, last_row = np.float32(columns - 1), np.float32(rows - 1)
    for k in prange(nz):
        for j in range(ny):
            line = out[k, j]
            for view in range(views):
                m = matrices[view]
                image = images[view]
                a = np.float32(m[0, 1] * j + m[0, 2] * k + m[0, 3])
                e = np.float32(m[1, 1] * j + m[1, 2] * k + m[1, 3])
                d = np.float32(m[2, 1] * j + m[2, 2] * k + m[2, 3])
                a1, e1, d1 = np.float32(m[0, 0]), np.float32(m[1, 0]), np.float32(m[2, 0])
                scale = np.float32(scales[view])
                for i in range(nx):
                    t = np.float32(i)
                    near = np.float32(1.0) / (d + t * d1)
                    column = (a + t * a1) * near
                    row = (e + t * e1) * near
                    if (
                        column < -half
                        or row < -half
                        or column > last_column + half
                        or row > last_row + half
                    ):
                        continue
                    column = min(max(column, zero), last_column)
                    row = min(max(row, zero), last_row)
                    c, r = np.int32(column), np.int32(row)
                    c1, r1 = min(c + 1, columns - 1), min(r + 1, rows - 1)
                    f, g = column - np.float32(c), row - np.float32(r)
                    low = image[r, c] + f * (image[r, c1] - image[r, c])
                    high = image[r1, c] + f * (image[r1, c1] - image[r1, c])
                    line[i] += scale * near * near * (low + g * (high - low))
