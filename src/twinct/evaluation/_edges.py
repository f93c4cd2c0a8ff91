"""Kernel: cubic interpolation along profiles across edges."""

# numba cannot be typed: compiled functions take any numeric type.
# pyright: basic
import numpy as np
from numba import njit

from twinct.evaluation._bits import OPTIONS


@njit(**OPTIONS)
def _taps(t, out):
    """Write the weights of the four voxels around a place, a share t after the second one."""
    out[0] = ((-0.5 * t + 1.0) * t - 0.5) * t
    out[1] = (1.5 * t - 2.5) * t * t + 1.0
    out[2] = ((-1.5 * t + 2.0) * t + 0.5) * t
    out[3] = (0.5 * t - 0.5) * t * t


@njit(**OPTIONS)
def cubic(volume, at):
    """Interpolate by Keys' cubic convolution, a = -1/2, at voxel indices (profiles, places, 3).

    All places must be two voxels from the volume's end.
    """
    found, taps, first = np.zeros(at.shape[:2]), np.empty((3, 4)), np.empty(3, np.int64)
    for n in range(at.shape[0]):
        for m in range(at.shape[1]):
            for axis in range(3):
                low = np.floor(at[n, m, axis])
                first[axis] = int(low) - 1
                _taps(at[n, m, axis] - low, taps[axis])
            k, j, i = first[0], first[1], first[2]
            for dz in range(4):
                for dy in range(4):
                    line = 0.0
                    for dx in range(4):
                        line += taps[2, dx] * volume[k + dz, j + dy, i + dx]
                    found[n, m] += taps[0, dz] * taps[1, dy] * line
    return found
