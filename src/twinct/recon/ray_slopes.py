"""Derivatives of line integrals by the poses of source and panel.

A ray from the source S through a pixel P = D + a u + b v has the line integral (``projector``)

    p = m sum_k x(q_k),   m = mm per plane,   q_k = S + s_k (P - S),

with bilinear samples in the planes k across the axis that the ray crosses fastest. So p is a
function of S and P, which is smooth except where a sample passes from one voxel's neighbours to the
next. The derivatives are those of this sum itself, not of the integral that it approximates.
"""

# numba cannot be typed: compiled functions take any numeric type.
# pyright: basic
from __future__ import annotations

import math

import numpy as np
from numba import njit, prange
from numpy.typing import ArrayLike

from twinct.geometry import Floats
from twinct.rays.joseph import OPTIONS, ray_of, within
from twinct.recon.projector import Projector, readable


def ray_slopes(A: Projector, x: ArrayLike, view: int) -> Floats:
    """Return the derivatives of one view's line integrals by each ray's ends.

    Args:
        A: the projector.
        x: volume, (z, y, x).
        view: number of the view.

    Returns:
        (2, 3, rows, columns), in the unit of ``x``, along the world's axes: by the source, and by
        the pixel's centre.
    """
    volume = readable(x, A.domain_shape, "the volume")
    out: Floats = np.empty((*A.range_shape[1:], 2, 3))
    _slopes(volume, A.index_rays[view], out)
    world_from_index = A.grid.world_from_grid.rotation / A.grid.voxel
    return np.einsum("rcei,wi->ewrc", out, world_from_index)


def slopes_along(A: Projector, x: ArrayLike, view: int, tangents: Floats) -> Floats:
    """Return the derivatives of one view's line integrals by any numbers that move its poses.

    Args:
        A: the projector.
        x: volume, (z, y, x).
        view: number of the view.
        tangents: derivatives of S, D, u and v by the numbers, (n, 4, 3).

    Returns:
        (n, rows, columns), in the units of the line integrals over those of the numbers.
    """
    by_source, by_pixel = ray_slopes(A, x, view)
    across, down = _offsets(A)
    found = np.empty((len(tangents), *A.range_shape[1:]))
    for along, (source, centre, u, v) in zip(found, tangents, strict=True):
        along[:] = np.tensordot(source, by_source, 1) + np.tensordot(centre, by_pixel, 1)
        along += across * np.tensordot(u, by_pixel, 1) + down * np.tensordot(v, by_pixel, 1)
    return found


def pose_gradient(A: Projector, x: ArrayLike, y: ArrayLike) -> Floats:
    """Return the derivatives of <y, A(x)> by the source, the panel's centre, and its axes.

    Args:
        A: the projector.
        x: volume, (z, y, x).
        y: weights of the line integrals, (views, rows, columns).

    Returns:
        (views, 4, 3), by S and D in 1/mm, by u and v, in the world, times the units of ``y`` and of
        the line integrals.
    """
    weights = readable(y, A.range_shape, "the weights")
    gradient = np.empty((len(A), 4, 3))
    across, down = _offsets(A)
    for view, weight in enumerate(weights):
        by_source, by_pixel = ray_slopes(A, x, view) * weight
        gradient[view] = [
            by_source.sum(axis=(1, 2)),
            by_pixel.sum(axis=(1, 2)),
            (by_pixel * across).sum(axis=(1, 2)),
            (by_pixel * down).sum(axis=(1, 2)),
        ]
    return gradient


def _offsets(A: Projector) -> tuple[Floats, Floats]:
    """Return places of pixels along u, (1, columns), and along v, (rows, 1), mm."""
    panel = A.geometry.panel
    left, top = panel.first_pixel_mm
    across: Floats = left + panel.pitch_u * np.arange(panel.columns, dtype=np.float64)
    down: Floats = top + panel.pitch_v * np.arange(panel.rows, dtype=np.float64)
    return across[None], down[:, None]


@njit(parallel=True, **OPTIONS)
def _slopes(x, rays, out):
    """Write the derivatives by source and pixel, in voxel indices, (rows, columns, 2, 3)."""
    sizes = (x.shape[2], x.shape[1], x.shape[0])
    strides = (1, x.shape[2], x.shape[1] * x.shape[2])
    voxels = x.reshape(-1)
    for row in prange(out.shape[0]):
        for column in range(out.shape[1]):
            source, way, axis, mm = ray_of(rays, row, column)
            b, c = (axis + 1) % 3, (axis + 2) % 3
            low, high = 0.0, sizes[axis] - 1.0
            slope_b, slope_c = way[b] / way[axis], way[c] / way[axis]
            start_b = source[b] - source[axis] * slope_b
            start_c = source[c] - source[axis] * slope_c
            low, high = within(low, high, start_b, slope_b, sizes[b])
            low, high = within(low, high, start_c, slope_c, sizes[c])
            total = by_b = by_c = far_b = far_c = 0.0
            for plane in range(math.ceil(low), math.floor(high) + 1):
                i, f, inside_b = _cell(start_b + plane * slope_b, sizes[b])
                j, g, inside_c = _cell(start_c + plane * slope_c, sizes[c])
                at = plane * strides[axis] + i * strides[b] + j * strides[c]
                v00, v10 = voxels[at], voxels[at + strides[b]]
                v01, v11 = voxels[at + strides[c]], voxels[at + strides[b] + strides[c]]
                share = (plane - source[axis]) / way[axis]
                along_b = inside_b * ((1 - g) * (v10 - v00) + g * (v11 - v01))
                along_c = inside_c * ((1 - f) * (v01 - v00) + f * (v11 - v10))
                total += (1 - f) * ((1 - g) * v00 + g * v01) + f * ((1 - g) * v10 + g * v11)
                by_b += along_b
                by_c += along_c
                far_b += share * along_b
                far_c += share * along_c
            square = 0.0
            for one in range(3):
                square += (way[one] * rays[4, one]) ** 2
            for one in range(3):  # by the length of a ray per plane
                longer = total * mm * way[one] * rays[4, one] ** 2 / square
                out[row, column, 0, one], out[row, column, 1, one] = -longer, longer
            out[row, column, 0, axis] += total * mm / way[axis]
            out[row, column, 1, axis] -= total * mm / way[axis]
            # By the places of the samples.
            out[row, column, 0, b] += mm * (by_b - far_b)
            out[row, column, 0, c] += mm * (by_c - far_c)
            out[row, column, 1, b] += mm * far_b
            out[row, column, 1, c] += mm * far_c
            out[row, column, 0, axis] -= mm * (slope_b * (by_b - far_b) + slope_c * (by_c - far_c))
            out[row, column, 1, axis] -= mm * (slope_b * far_b + slope_c * far_c)


@njit(**OPTIONS)
def _cell(at, size):
    """Return the lower voxel, the upper one's weight, and 1 unless the weight is constant here."""
    if at <= 0.0:
        return 0, 0.0, 0.0
    if at >= size - 1.0:
        return size - 2, 1.0, 0.0
    low = min(int(at), size - 2)
    return low, at - low, 1.0
