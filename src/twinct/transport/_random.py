"""Kernels: random numbers by a counter, one stream for each photon.

Number n of a stream is the counter ``state + n * GOLDEN``, mixed by the function of SplitMix64
(Steele, Lea, Flood, OOPSLA 2014). So a photon's numbers depend on its batch's key and its index
alone, whichever thread follows it.
"""

# numba cannot be typed: compiled functions take any numeric type.
# pyright: basic
import numpy as np
from numba import njit

OPTIONS = {"cache": True, "nogil": True, "error_model": "numpy"}

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST = np.uint64(0xBF58476D1CE4E5B9)
_SECOND = np.uint64(0x94D049BB133111EB)
_STREAMS = np.uint64(0xD1342543DE82EF95)
_U11, _U27, _U30, _U31 = np.uint64(11), np.uint64(27), np.uint64(30), np.uint64(31)
_UNIT = 2.0**-53


@njit(**OPTIONS)
def _mixed(z):
    z = (z ^ (z >> _U30)) * _FIRST
    z = (z ^ (z >> _U27)) * _SECOND
    return z ^ (z >> _U31)


@njit(**OPTIONS)
def stream(key, index):
    """Return the first state of photon ``index`` of the batch with a key."""
    return _mixed(key ^ _mixed(np.uint64(index) * _STREAMS + GOLDEN))


@njit(**OPTIONS)
def draw(state):
    """Return the next state, and a number in [0, 1)."""
    state = state + GOLDEN
    return state, np.float64(_mixed(state) >> _U11) * _UNIT
