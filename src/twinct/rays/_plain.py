"""Numba kernel: crossings of one view's rays with the triangles of a mesh."""

# numba cannot be typed: compiled functions take any numeric type.
# pyright: basic
import numpy as np
from numba import njit

ASIDE = 0.5127, 0.3891, 0.7653
"""Infinitesimal step of a ray that meets an edge exactly; any direction will do."""


@njit(cache=True, nogil=True)
def _cross(a, b):
    """Return the cross product, with exact negation when the vectors are exchanged."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit(cache=True, nogil=True)
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, nogil=True)
def _side(way, edge):
    """Return a number whose sign is the side of an edge on which a ray passes.

    The two triangles of the edge get opposite signs.
    """
    side = _dot(way, edge)
    return side if side != 0.0 else _dot(ASIDE, edge)


@njit(cache=True, nogil=True)
def crossings(points, triangles, places, source, pixel, across, up, corner, lengths, slopes):
    """Add the path lengths inside a closed mesh, and their derivatives by its motion.

    Args:
        points: corners of the mesh relative to the source, (points, 3), mm.
        triangles: indices of corners, (triangles, 3), counter-clockwise seen from outside.
        places: projections of the corners, (points, 2), (column, row) in pixels of the whole panel.
        source: (3,), in the mesh's frame, mm.
        pixel: vector from the source to pixel (0, 0), (3,), mm.
        across: step to the next column, (3,), mm.
        up: step to the next row, (3,), mm.
        corner: (row, column) of the first pixel of the arrays below.
        lengths: path lengths, (rows, columns), mm.
        slopes: derivatives by (v, w) in the mesh's axes, (rows, columns, 6), mm per mm and rad;
            not computed if the last axis is empty.
    """
    rows, columns = lengths.shape
    for t in range(len(triangles)):
        i, j, k = triangles[t]
        a = points[i, 0], points[i, 1], points[i, 2]
        b = points[j, 0], points[j, 1], points[j, 2]
        c = points[k, 0], points[k, 1], points[k, 2]
        e0, e1, e2 = _cross(b, c), _cross(c, a), _cross(a, b)
        normal = e0[0] + e1[0] + e2[0], e0[1] + e1[1] + e2[1], e0[2] + e1[2] + e2[2]
        height = _dot(normal, a)
        left = min(places[i, 0], places[j, 0], places[k, 0])
        right = max(places[i, 0], places[j, 0], places[k, 0])
        low = min(places[i, 1], places[j, 1], places[k, 1])
        high = max(places[i, 1], places[j, 1], places[k, 1])
        first_row, last_row = max(int(low), corner[0]), min(int(high) + 1, corner[0] + rows - 1)
        first, last = max(int(left), corner[1]), min(int(right) + 1, corner[1] + columns - 1)
        for row in range(first_row, last_row + 1):
            for column in range(first, last + 1):
                way = (
                    pixel[0] + column * across[0] + row * up[0],
                    pixel[1] + column * across[1] + row * up[1],
                    pixel[2] + column * across[2] + row * up[2],
                )
                s0, s1, s2 = _side(way, e0), _side(way, e1), _side(way, e2)
                out = s0 > 0 and s1 > 0 and s2 > 0
                if not out and not (s0 < 0 and s1 < 0 and s2 < 0):
                    continue
                steep = _dot(way, normal)
                if steep == 0.0:
                    continue
                far, share = np.sqrt(_dot(way, way)), height / steep
                sign = 1.0 if out else -1.0
                r, q = row - corner[0], column - corner[1]
                lengths[r, q] += sign * share * far
                if slopes.shape[2]:
                    at = (
                        source[0] + share * way[0],
                        source[1] + share * way[1],
                        source[2] + share * way[2],
                    )
                    turn, factor = _cross(at, normal), sign * far / steep
                    for n in range(3):
                        slopes[r, q, n] += factor * normal[n]
                        slopes[r, q, 3 + n] += factor * turn[n]
