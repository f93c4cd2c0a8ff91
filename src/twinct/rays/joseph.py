"""Rays of Joseph's method, in plain numba: of the plain projector, and of mixtures of voxels.

A ray is sampled once in each plane of voxel centres across the axis that it crosses fastest. Views
are as in ``projector``: source, pixel (0, 0), step to the next column, step to the next row, all in
voxel indices (x, y, z), and the edges of a voxel in mm, (5, 3).
"""

# numba cannot be typed: compiled functions take any numeric type.
# pyright: basic
import math

from numba import njit

OPTIONS = {"cache": True, "nogil": True, "error_model": "numpy"}
"""Without fast mathematics: sums keep their order, whatever process compiles them."""


@njit(**OPTIONS)
def ray_of(rays, row, column):
    """Return a ray's source, vector to its pixel, fastest axis, and mm per plane.

    Source and vector are in voxel indices (x, y, z).
    """
    source = rays[0, 0], rays[0, 1], rays[0, 2]
    way = (
        rays[1, 0] + row * rays[3, 0] + column * rays[2, 0] - source[0],
        rays[1, 1] + row * rays[3, 1] + column * rays[2, 1] - source[1],
        rays[1, 2] + row * rays[3, 2] + column * rays[2, 2] - source[2],
    )
    axis = 0
    for other in (1, 2):
        if abs(way[other]) > abs(way[axis]):
            axis = other
    x, y, z = way[0] * rays[4, 0], way[1] * rays[4, 1], way[2] * rays[4, 2]
    return source, way, axis, math.sqrt(x * x + y * y + z * z) / abs(way[axis])


@njit(**OPTIONS)
def within(low, high, start, slope, size):
    """Return the part of a range of planes in which a ray is between two faces of the grid.

    The ray is at start + plane slope; the faces are at -0.5 and size - 0.5.
    """
    below, above = -0.5 - start, size - 0.5 - start
    if slope > 0.0:
        low = max(low, below / slope)
        high = min(high, above / slope)
    elif slope < 0.0:
        low = max(low, above / slope)
        high = min(high, below / slope)
    elif below > 0.0 or above < 0.0:
        high = low - 1.0
    return low, high
