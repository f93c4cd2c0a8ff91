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
from twinct.transport.cross_sections import TOTAL, TRANSFER


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
        around: medium around the grid, or -1 for vacuum.
        around_density: its density, g/cm^3.
    """

    codes: NDArray[np.uint16]
    media: NDArray[np.int64]
    densities: NDArray[np.float64]
    edges: NDArray[np.float64]
    brick: NDArray[np.int64]
    brick_media: NDArray[np.uint8]
    brick_densities: NDArray[np.float64]
    around: int
    around_density: float


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
def inside(x, y, z, voxels):
    """Return True if a point lies in the grid."""
    nz, ny, nx = voxels.codes.shape
    return (
        0.0 <= x <= nx * voxels.edges[0]
        and 0.0 <= y <= ny * voxels.edges[1]
        and 0.0 <= z <= nz * voxels.edges[2]
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
def _walk(x, y, z, dx, dy, dz, t, edges, shape):
    """Return cells (z, y, x) at ``t``, ends of their edges on the ray, increments and lengths."""
    i, step_i, end_x, way_x = _axis(x, dx, t, edges[0], shape[2])
    j, step_j, end_y, way_y = _axis(y, dy, t, edges[1], shape[1])
    k, step_k, end_z, way_z = _axis(z, dz, t, edges[2], shape[0])
    return (k, j, i), (end_z, end_y, end_x), (step_k, step_j, step_i), (way_z, way_y, way_x)


@njit(**OPTIONS)
def _next(cell, ends, steps, ways):
    """Return the next cell, and the ends of its edges on the ray."""
    k, j, i = cell
    end_z, end_y, end_x = ends
    if end_x <= end_y and end_x <= end_z:
        return (k, j, i + steps[2]), (end_z, end_y, end_x + ways[2])
    if end_y <= end_z:
        return (k, j + steps[1], i), (end_z, end_y + ways[1], end_x)
    return (k + steps[0], j, i), (end_z + ways[0], end_y, end_x)


@njit(**OPTIONS)
def _within(cell, shape):
    """Return True if a cell is one of the grid's."""
    return 0 <= cell[0] < shape[0] and 0 <= cell[1] < shape[1] and 0 <= cell[2] < shape[2]


@njit(**OPTIONS)
def add_energy(rows, deposits, code, voxel, energy):
    """Add an energy to a row of the palette and, if there are any, to a voxel."""
    rows[code] += energy
    if deposits.size:
        deposits[voxel] += energy


@njit(**OPTIONS)
def fly(state, x, y, z, dx, dy, dz, index, fraction, voxels, media, scores):
    """Return state, and the length of the way to the next collision; -1 if the photon leaves.

    A photon leaves if it does not head for the grid; before the grid it may collide. ``scores``
    has the sums of ``add_energy`` and whether to add to them: each tentative collision adds the
    mean energy that the photon gives to electrons there, over the majorant.
    """
    rows, deposits, expected = scores
    t, last = span(x, y, z, dx, dy, dz, voxels)
    if t >= last:
        return state, -1.0
    state, u = draw(state)
    depth = -math.log(1.0 - u)
    if t > 0.0 and voxels.around >= 0:
        mu = voxels.around_density * coefficient(media, voxels.around, index, fraction, TOTAL)
        if depth < t * mu:
            return state, depth / mu
        depth -= t * mu
    shape = voxels.brick_media.shape
    edges = (
        voxels.edges[0] * voxels.brick[0],
        voxels.edges[1] * voxels.brick[1],
        voxels.edges[2] * voxels.brick[2],
    )
    cell, ends, steps, ways = _walk(x, y, z, dx, dy, dz, t, edges, shape)
    while t < last and _within(cell, shape):
        end = max(min(ends[0], ends[1], ends[2], last), t)
        majorant = voxels.brick_densities[cell] * coefficient(
            media, voxels.brick_media[cell], index, fraction, TOTAL
        )
        while depth < (end - t) * majorant:
            t += depth / majorant
            voxel = voxel_at(x + t * dx, y + t * dy, z + t * dz, voxels)
            code = voxels.codes[voxel]
            if expected:
                given = coefficient(media, voxels.media[code], index, fraction, TRANSFER)
                given *= voxels.densities[code] / majorant
                add_energy(rows, deposits, code, voxel, given)
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
        cell, ends = _next(cell, ends, steps, ways)
    return state, -1.0


@njit(**OPTIONS)
def optical_depth(x, y, z, dx, dy, dz, length, index, fraction, voxels, media):
    """Return the line integral of mu along a ray up to a length."""
    t, last = span(x, y, z, dx, dy, dz, voxels)
    last = min(last, length)
    depth = 0.0
    if voxels.around >= 0:
        mu = coefficient(media, voxels.around, index, fraction, TOTAL)
        depth = (length - max(last - t, 0.0)) * voxels.around_density * mu
    shape = voxels.codes.shape
    cell, ends, steps, ways = _walk(x, y, z, dx, dy, dz, t, voxels.edges, shape)
    known, density, mu = -1, 0.0, 0.0
    while t < last and _within(cell, shape):
        end = max(min(ends[0], ends[1], ends[2], last), t)
        code = voxels.codes[cell]
        if code != known:  # most neighbours are equal
            known, density = code, voxels.densities[code]
            mu = coefficient(media, voxels.media[code], index, fraction, TOTAL)
        depth += (end - t) * density * mu
        t = end
        cell, ends = _next(cell, ends, steps, ways)
    return depth


@njit(**OPTIONS)
def add_amounts(x, y, z, dx, dy, dz, length, voxels, amounts):
    """Add the line integral of each medium's density along a ray, mm g/cm^3."""
    t, last = span(x, y, z, dx, dy, dz, voxels)
    last = min(last, length)
    if voxels.around >= 0:
        amounts[voxels.around] += (length - max(last - t, 0.0)) * voxels.around_density
    shape = voxels.codes.shape
    cell, ends, steps, ways = _walk(x, y, z, dx, dy, dz, t, voxels.edges, shape)
    while t < last and _within(cell, shape):
        end = max(min(ends[0], ends[1], ends[2], last), t)
        code = voxels.codes[cell]
        amounts[voxels.media[code]] += (end - t) * voxels.densities[code]
        t = end
        cell, ends = _next(cell, ends, steps, ways)
