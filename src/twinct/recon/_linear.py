"""Kernel: linear interpolation of an image along both axes."""

# numba cannot be typed: compiled functions take any numeric type.
# pyright: basic
import numpy as np
from numba import njit, types

SINGLES, PLACES = types.float32, types.Array(types.int64, 1, "C", readonly=True)
SHARES = types.Array(SINGLES, 1, "C", readonly=True)
IMAGE = types.Array(SINGLES, 2, "C", readonly=True)


# The signature makes numba compile when the module is loaded: with the engine, during a scan.
@njit(
    types.void(IMAGE, PLACES, SHARES, PLACES, SHARES, SINGLES[:, ::1]),
    cache=True,
    nogil=True,
    error_model="numpy",
)
def blend(image, rows, row_shares, columns, column_shares, out):
    """Write (1 - share) of a value and share of the next one, along rows, then along columns."""
    last, width = len(image) - 1, image.shape[1]
    line = np.empty(width + 1, np.float32)
    for r in range(len(rows)):
        here, there = image[rows[r]], image[min(rows[r] + 1, last)]
        for c in range(width):
            line[c] = (there[c] - here[c]) * row_shares[r] + here[c]
        line[width] = line[width - 1]
        for c in range(len(columns)):
            low = columns[c]
            out[r, c] = (line[low + 1] - line[low]) * column_shares[c] + line[low]
