"""Kernels: the side of a projected edge on which a ray passes, with an exact sign.

A point has homogeneous coordinates (column w, row w, w); the edge from a to b and the ray of a
pixel have the determinant of (a, b, pixel). Each triangle that shares an edge gets the same sign of
it, and the opposite one for the opposite order, because no sign depends on rounding.
"""

# numba cannot be typed: compiled functions take any numeric type.
# pyright: basic
import numpy as np
from numba import njit

OPTIONS = {"cache": True, "nogil": True, "error_model": "numpy"}
"""Without fast mathematics: exact sums rely on the order of additions."""

CERTAIN = 1e-10
"""Share of its terms above which the sign of a rounded sum is certain, and its value accurate."""

_HALF = 134217729.0
"""2^27 + 1 splits a double into two halves whose products are exact."""

_TERMS = 20
"""Largest number of doubles in a determinant."""

_TOUCH = 1e-300
"""Size of a side that is 0: the ray meets the edge, and only the sign counts."""


@njit(**OPTIONS)
def _exact_sum(a, b):
    """Return the rounded sum, and its error."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


@njit(**OPTIONS)
def _exact_product(a, b):
    """Return the rounded product, and its error."""
    product = a * b
    high_a, high_b = _HALF * a, _HALF * b
    high_a, high_b = high_a - (high_a - a), high_b - (high_b - b)
    low_a, low_b = a - high_a, b - high_b
    return product, low_a * low_b - (
        ((product - high_a * high_b) - low_a * high_b) - high_a * low_b
    )


@njit(**OPTIONS)
def _add_exactly(terms, count, value):
    """Add a value to a sum of ``count`` doubles that do not overlap, in ascending order."""
    for i in range(count):
        value, terms[i] = _exact_sum(value, terms[i])
    terms[count] = value
    return count + 1


@njit(**OPTIONS)
def _exact_determinant(a, b, column, row, one):
    """Return the determinant of (a, b, (column, row, one)), rounded only at the end."""
    terms = np.empty(_TERMS)
    count = 0
    for factor, i, j in ((column, 1, 2), (row, 2, 0), (one, 0, 1)):
        for sign, left, right in ((factor, a[i], b[j]), (-factor, a[j], b[i])):
            for part in _exact_product(left, right):
                product, error = _exact_product(sign, part)
                count = _add_exactly(terms, count, error)
                count = _add_exactly(terms, count, product)
    total = 0.0
    for i in range(count):
        total += terms[i]
    return total


@njit(**OPTIONS)
def side(a, b, column, row):
    """Return the determinant of (a, b, (column, row, 1)), with an exact sign.

    A ray that meets the edge passes it as if the pixel lay an infinitesimal step towards higher
    columns and, along columns, towards higher rows. The result is 0 only for an edge that points at
    the source.
    """
    x, y, w = a[1] * b[2], a[2] * b[0], a[0] * b[1]
    minus_x, minus_y, minus_w = a[2] * b[1], a[0] * b[2], a[1] * b[0]
    total = column * (x - minus_x) + row * (y - minus_y) + (w - minus_w)
    size = (
        abs(column) * (abs(x) + abs(minus_x))
        + abs(row) * (abs(y) + abs(minus_y))
        + (abs(w) + abs(minus_w))
    )
    if abs(total) > CERTAIN * size:
        return total
    total = _exact_determinant(a, b, column, row, 1.0)
    if total != 0.0:
        return total
    along = _exact_determinant(a, b, 1.0, 0.0, 0.0)
    if along == 0.0:
        along = _exact_determinant(a, b, 0.0, 1.0, 0.0)
    return np.sign(along) * _TOUCH


@njit(**OPTIONS)
def crossing(a, b, c, column, row):
    """Return the depth w at which a ray leaves a triangle's side, negative where it enters.

    It is 0 for a ray that misses the triangle, or meets it behind the source.
    """
    to_a, to_b, to_c = side(b, c, column, row), side(c, a, column, row), side(a, b, column, row)
    leaves = to_a < 0 and to_b < 0 and to_c < 0
    if not leaves and not (to_a > 0 and to_b > 0 and to_c > 0):
        return 0.0
    depth = (to_a * a[2] + to_b * b[2] + to_c * c[2]) / (to_a + to_b + to_c)
    if depth <= 0:
        return 0.0
    return depth if leaves else -depth
