"""Kernels: flights of photons through voxels.

Delta tracking (Woodcock et al., ANL-7050, 1965) with a majorant for each brick of voxels: a photon
crosses the bricks on its way, and a tentative collision in one counts with the probability
mu / majorant. So metal slows only its own bricks.
"""

# numba cannot be typed: compiled functions take any numeric type.
# pyright: basic
import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from twinct.transport._angles import coefficient
from twinct.transport._random import OPTIONS, draw
from twinct.transport.cross_sections import TOTAL


class Voxels(NamedTuple):
    """A body's voxels for the kernels, in the frame of the grid's low corner.

    Attributes:
        codes: row of the palette of each voxel, (z, y, x), uint16.
        media: medium of each row of the palette, int64.
        densities: density of each row of the palette, g/cm^3, float64.
        edges: edges of a voxel along (x, y, z), mm.
        brick: voxels of a brick along (x, y, z).
        brick_media: medium that bounds each brick's attenuation, (z, y, x), uint8.
        brick_densities: density of that medium that suffices at all energies, float64.
        uniform: row of the palette that fills a brick, or -1, (z, y, x), int32.
    """

    codes: NDArray[np.uint16]
    media: NDArray[np.int64]
    densities: NDArray[np.float64]
    edges: NDArray[np.float64]
    brick: NDArray[np.int64]
    brick_media: NDArray[np.uint8]
    brick_densities: NDArray[np.float64]
    uniform: NDArray[np.int32]


@njit(**OPTIONS)
def span(x, y, z, dx, dy, dz, voxels):
    """Return where a ray enters and leaves the grid, mm; it misses if the first is larger."""
    nz, ny, nx = voxels.codes.shape
    first, last = 0.0, math.inf
    for start, step, size in (
        (x, dx, nx * voxels.edges[0]),
        (y, dy, ny * voxels.edges[1]),
        (z, dz, nz * voxels.edges[2]),
    ):
        if step == 0.0:
            if start < 0.0 or start > size:
                last = -1.0
        else:
            a, b = -start / step, (size - start) / step
            first, last = max(first, min(a, b)), min(last, max(a, b))
    return first, last


@njit(**OPTIONS)
def voxel_at(x, y, z, voxels):
    """Return the indices (z, y, x) of the voxel at a point, or of the nearest one."""
    nz, ny, nx = voxels.codes.shape
    return (
        min(max(int(z / voxels.edges[2]), 0), nz - 1),
        min(max(int(y / voxels.edges[1]), 0), ny - 1),
        min(max(int(x / voxels.edges[0]), 0), nx - 1),
    )


@njit(**OPTIONS)
def _axis(start, step, t, edge, number):
    """Return cell, increment, end of the cell on the ray, and length per cell."""
    cell = min(max(int((start + t * step) / edge), 0), number - 1)
    if step > 0.0:
        return cell, 1, ((cell + 1) * edge - start) / step, edge / step
    if step < 0.0:
        return cell, -1, (cell * edge - start) / step, -edge / step
    return cell, 0, math.inf, math.inf


@njit(**OPTIONS)
def fly(state, x, y, z, dx, dy, dz, index, fraction, voxels, media):
    """Return state, and the length of the way to the next collision; -1 if the photon leaves."""
    t, last = span(x, y, z, dx, dy, dz, voxels)
    if t >= last:
        return state, -1.0
    bz, by, bx = voxels.brick_media.shape
    i, step_i, end_x, way_x = _axis(x, dx, t, voxels.edges[0] * voxels.brick[0], bx)
    j, step_j, end_y, way_y = _axis(y, dy, t, voxels.edges[1] * voxels.brick[1], by)
    k, step_k, end_z, way_z = _axis(z, dz, t, voxels.edges[2] * voxels.brick[2], bz)
    state, u = draw(state)
    depth = -math.log(1.0 - u)
    while True:
        end = max(min(end_x, end_y, end_z, last), t)
        majorant = voxels.brick_densities[k, j, i] * coefficient(
            media, voxels.brick_media[k, j, i], index, fraction, TOTAL
        )
        while depth < (end - t) * majorant:
            t += depth / majorant
            if voxels.uniform[k, j, i] >= 0:
                return state, t
            kk, jj, ii = voxel_at(x + t * dx, y + t * dy, z + t * dz, voxels)
            code = voxels.codes[kk, jj, ii]
            mu = voxels.densities[code] * coefficient(
                media, voxels.media[code], index, fraction, TOTAL
            )
            state, u = draw(state)
            if u * majorant < mu:
                return state, t
            state, u = draw(state)
            depth = -math.log(1.0 - u)
        depth -= (end - t) * majorant
        t = end
        if t >= last:
            return state, -1.0
        if end_x <= end_y and end_x <= end_z:
            i, end_x = i + step_i, end_x + way_x
            inside = 0 <= i < bx
        elif end_y <= end_z:
            j, end_y = j + step_j, end_y + way_y
            inside = 0 <= j < by
        else:
            k, end_z = k + step_k, end_z + way_z
            inside = 0 <= k < bz
        if not inside:
            return state, -1.0


@njit(**OPTIONS)
def optical_depth(x, y, z, dx, dy, dz, length, index, fraction, voxels, media):
    """Return the line integral of mu along a ray up to a length."""
    depth = 0.0
    t, last = span(x, y, z, dx, dy, dz, voxels)
    last = min(last, length)
    if t >= last:
        return depth
    nz, ny, nx = voxels.codes.shape
    i, step_i, end_x, way_x = _axis(x, dx, t, voxels.edges[0], nx)
    j, step_j, end_y, way_y = _axis(y, dy, t, voxels.edges[1], ny)
    k, step_k, end_z, way_z = _axis(z, dz, t, voxels.edges[2], nz)
    while t < last and 0 <= i < nx and 0 <= j < ny and 0 <= k < nz:
        end = max(min(end_x, end_y, end_z, last), t)
        code = voxels.codes[k, j, i]
        mu = coefficient(media, voxels.media[code], index, fraction, TOTAL)
        depth += (end - t) * voxels.densities[code] * mu
        t = end
        if end_x <= end_y and end_x <= end_z:
            i, end_x = i + step_i, end_x + way_x
        elif end_y <= end_z:
            j, end_y = j + step_j, end_y + way_y
        else:
            k, end_z = k + step_k, end_z + way_z
    return depth


@njit(**OPTIONS)
def add_amounts(x, y, z, dx, dy, dz, length, voxels, amounts):
    """Add the line integral of each medium's density along a ray, mm g/cm^3."""
    t, last = span(x, y, z, dx, dy, dz, voxels)
    last = min(last, length)
    if t >= last:
        return
    nz, ny, nx = voxels.codes.shape
    i, step_i, end_x, way_x = _axis(x, dx, t, voxels.edges[0], nx)
    j, step_j, end_y, way_y = _axis(y, dy, t, voxels.edges[1], ny)
    k, step_k, end_z, way_z = _axis(z, dz, t, voxels.edges[2], nz)
    while t < last and 0 <= i < nx and 0 <= j < ny and 0 <= k < nz:
        end = max(min(end_x, end_y, end_z, last), t)
        code = voxels.codes[k, j, i]
        amounts[voxels.media[code]] += (end - t) * voxels.densities[code]
        t = end
        if end_x <= end_y and end_x <= end_z:
            i, end_x = i + step_i, end_x + way_x
        elif end_y <= end_z:
            j, end_y = j + step_j, end_y + way_y
        else:
            k, end_z = k + step_k, end_z + way_z
