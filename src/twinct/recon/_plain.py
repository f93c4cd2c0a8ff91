"""Plain engine: every kernel as in its formula, one sample at a time, rays in float64.

It is the reference for the vector engine, and the fallback where that engine does not compile. The
operations are described in ``engine``; the forward model is Joseph's, see ``projector``.
"""

# numba cannot be typed: compiled functions take any numeric type.
# pyright: basic
from __future__ import annotations

import numpy as np
from numba import njit, prange

from twinct.rays.joseph import OPTIONS, ray_of
from twinct.recon import _variation
from twinct.recon._variation import weigh as weigh
from twinct.recon.blocks import EDGE, EVERYWHERE

OTHERS = ((1, 2), (0, 2), (0, 1))
"""The two other axes for each of x, y, z."""


def hold(array):
    """Return the array itself: the kernels work in the processor's memory."""
    return array


def require(size):
    """Do nothing: ``recon.memory`` checks the processor's memory."""


def room(shape):
    """Return a float32 array to be overwritten."""
    return np.empty(shape, np.float32)


def bring(held, out):
    """Copy what is held to ``out``, if it is not ``out`` itself."""
    if held is not out:
        out[:] = held


def leave_out(length, mask):
    """Set the lengths of masked pixels to 0."""
    length[~mask] = 0.0


@njit(**OPTIONS)
def _cell(source, way, axis, plane, other, size):
    """Return a ray's lower voxel in a plane along another axis, and the upper voxel's weight.

    The outermost voxels extend over their outer half; beyond it the voxel is -1.
    """
    at = source[other] + (plane - source[axis]) / way[axis] * way[other]
    if not -0.5 <= at <= size - 0.5:
        return -1, 0.0
    at = min(max(at, 0.0), size - 1.0)
    low = min(int(at), size - 2)
    return low, at - low


def forward(x, rays, out, blocks=EVERYWHERE, lengths=None):
    """Write the line integrals of ``x``, see ``engine``."""
    _forward(x, rays, out)
    if lengths is not None:
        chords(rays, x.shape, lengths)


@njit(parallel=True, **OPTIONS)
def _forward(x, rays, out):
    """Write line integrals: bilinear samples in each plane along a ray, times mm per plane."""
    nz, ny, nx = x.shape
    sizes, strides, voxels = (nx, ny, nz), (1, nx, nx * ny), x.reshape(-1)
    for row in prange(out.shape[0]):
        for column in range(out.shape[1]):
            source, way, axis, mm = ray_of(rays, row, column)
            b, c = OTHERS[axis]
            total = 0.0
            for plane in range(sizes[axis]):
                i, f = _cell(source, way, axis, plane, b, sizes[b])
                k, g = _cell(source, way, axis, plane, c, sizes[c])
                if i < 0 or k < 0:
                    continue
                at = plane * strides[axis] + i * strides[b] + k * strides[c]
                low = (1 - f) * voxels[at] + f * voxels[at + strides[b]]
                at += strides[c]
                high = (1 - f) * voxels[at] + f * voxels[at + strides[b]]
                total += (1 - g) * low + g * high
            out[row, column] = mm * total


@njit(**OPTIONS)
def adjoint(y, rays, out):
    """Add the transpose: the same samples with the same weights, in the other direction."""
    nz, ny, nx = out.shape
    sizes, strides, voxels = (nx, ny, nz), (1, nx, nx * ny), out.reshape(-1)
    for row in range(y.shape[0]):
        for column in range(y.shape[1]):
            source, way, axis, mm = ray_of(rays, row, column)
            b, c = OTHERS[axis]
            value = mm * y[row, column]
            for plane in range(sizes[axis]):
                i, f = _cell(source, way, axis, plane, b, sizes[b])
                k, g = _cell(source, way, axis, plane, c, sizes[c])
                if i < 0 or k < 0:
                    continue
                at = plane * strides[axis] + i * strides[b] + k * strides[c]
                voxels[at] += (1 - g) * (1 - f) * value
                voxels[at + strides[b]] += (1 - g) * f * value
                at += strides[c]
                voxels[at] += g * (1 - f) * value
                voxels[at + strides[b]] += g * f * value


@njit(parallel=True, **OPTIONS)
def chords(rays, shape, out):
    """Write the length of each ray in the grid, where it is between all six faces."""
    sizes = shape[2], shape[1], shape[0]
    for row in prange(out.shape[0]):
        for column in range(out.shape[1]):
            source, way, axis, mm = ray_of(rays, row, column)
            near, far = -np.inf, np.inf
            for other in range(3):
                to_faces = -0.5 - source[other], sizes[other] - 0.5 - source[other]
                if way[other] != 0.0:
                    one, two = to_faces[0] / way[other], to_faces[1] / way[other]
                    near, far = max(near, min(one, two)), min(far, max(one, two))
                elif to_faces[0] > 0.0 or to_faces[1] < 0.0:
                    far = -np.inf
            out[row, column] = mm * abs(way[axis]) * max(far - near, 0.0)


@njit(**OPTIONS)
def ratio(measured, estimate, length, relaxation, shortest, image, counts, missing):
    """Write residual over path length for the rays that count, with a border of one pixel."""
    rows, columns = measured.shape
    missing[0] = 0
    for row in range(rows + 2):
        r = min(max(row - 1, 0), rows - 1)
        so_far = 0
        missing[row + 1, 0] = 0
        for column in range(columns + 2):
            c = min(max(column - 1, 0), columns - 1)
            if length[r, c] >= shortest:
                image[row, column] = relaxation * (measured[r, c] - estimate[r, c]) / length[r, c]
                counts[row, column] = 1.0
            else:
                image[row, column] = 0.0
                counts[row, column] = 0.0
                so_far += 1
            missing[row + 1, column + 1] = missing[row, column + 1] + so_far


@njit(**OPTIONS)
def _bilinear(image, row, column):
    r, c = int(row), int(column)
    g, f = row - r, column - c
    low = (1 - f) * image[r, c] + f * image[r, c + 1]
    return (1 - g) * low + g * ((1 - f) * image[r + 1, c] + f * image[r + 1, c + 1])


def update(x, pixels, image, counts, missing, floor, blocks=EVERYWHERE):
    """Update the voxels, see ``engine``; ``missing`` is for engines that skip weights."""
    _update(x, pixels, image, counts, floor, blocks.filled)


@njit(parallel=True, **OPTIONS)
def _update(x, matrix, image, counts, floor, filled):
    """Update the voxels of filled blocks, or all voxels if ``filled`` is empty."""
    nz, ny, nx = x.shape
    rows, columns = image.shape[0] - 2, image.shape[1] - 2
    for k in prange(nz):
        for j in range(ny):
            for i in range(nx):
                if len(filled) > 0 and filled[k // EDGE, j // EDGE, i // EDGE] == 0:
                    continue
                m = matrix
                depth = m[2, 0] * i + m[2, 1] * j + m[2, 2] * k + m[2, 3]
                column = (m[0, 0] * i + m[0, 1] * j + m[0, 2] * k + m[0, 3]) / depth
                row = (m[1, 0] * i + m[1, 1] * j + m[1, 2] * k + m[1, 3]) / depth
                if -0.5 <= column <= columns - 0.5 and -0.5 <= row <= rows - 0.5:
                    # Columns and rows of the image count from one because of its border.
                    change = _bilinear(image, row + 1, column + 1)
                    weight = _bilinear(counts, row + 1, column + 1)
                    mean = change / weight if weight > 1e-3 else 0.0
                    x[k, j, i] = max(x[k, j, i] + mean, floor)


@njit(parallel=True, **OPTIONS)
def back_project(images, matrices, scales, out):
    """Back-project bilinearly; border pixels extend over their outer half, with 0 beyond."""
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


def ascend(b, q, dual, radii, known, seams, inverse, floor, step, blocks=EVERYWHERE):
    """Take a step on the duals of total variations, see ``engine``."""
    _variation.ascend(
        b, q, dual, radii, known, seams, inverse, np.float32(floor), step, blocks.filled
    )


def settle(b, q, dual, radii, inverse, floor, share, x, blocks=EVERYWHERE):
    """Write the volume, and the one with momentum, see ``engine``."""
    low, part = np.float32(floor), np.float32(share)
    _variation.settle(b, q, dual, radii, inverse, low, part, x, blocks.filled)
