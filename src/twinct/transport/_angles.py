"""Kernels: angles and energies after scattering, and their distributions."""

# numba cannot be typed: compiled functions take any numeric type.
# pyright: basic
import math

from numba import njit

from twinct.transport._random import OPTIONS, draw
from twinct.transport.cross_sections import (
    CELLS,
    ELECTRON_KEV,
    HC_KEV_ANGSTROM,
    LARGEST_X,
    LOWEST_KEV,
    STEP_KEV,
)

_LARGEST_Q = LARGEST_X**2


@njit(**OPTIONS)
def place_of(energy, length):
    """Return index and fraction of an energy among those of the coefficients."""
    place = (energy - LOWEST_KEV) / STEP_KEV
    index = min(max(int(place), 0), length - 2)
    return index, min(max(place - index, 0.0), 1.0)


@njit(**OPTIONS)
def coefficient(media, medium, index, fraction, column):
    """Return a coefficient, linear between two energies."""
    low = media.coefficients[medium, index, column]
    return low + fraction * (media.coefficients[medium, index + 1, column] - low)


@njit(**OPTIONS)
def line_energy(media, medium, index, fraction, u):
    """Return the energy of the line that a photoelectric absorption emits, or 0.

    ``u`` is uniform below the photoelectric coefficient.
    """
    sums = media.line_sums
    for line in range(sums.shape[2]):
        low = sums[medium, index, line]
        if u < low + fraction * (sums[medium, index + 1, line] - low):
            return media.line_energies[medium, line]
    return 0.0


@njit(**OPTIONS)
def _cell(q):
    """Return cell and fraction of x^2, linear in sqrt(x)."""
    place = CELLS * math.sqrt(math.sqrt(q / _LARGEST_Q))
    cell = min(int(place), CELLS - 1)
    return cell, place - cell


@njit(**OPTIONS)
def compton_shape(media, medium, energy, c):
    """Return KN(E, c) S(x), with KN(E, 1) = 1, and the remaining share of the energy."""
    left = 1.0 / (1.0 + energy / ELECTRON_KEV * (1.0 - c))
    cell, part = _cell((energy / HC_KEV_ANGSTROM) ** 2 * (0.5 - 0.5 * c))
    low = media.incoherent[medium, cell]
    s = low + part * (media.incoherent[medium, cell + 1] - low)
    return 0.5 * left * left * (left + 1.0 / left - (1.0 - c * c)) * s, left


@njit(**OPTIONS)
def scatter_compton(state, media, medium, energy):
    """Return state, cosine and remaining share of the energy; by rejection, so exactly."""
    cell, part = _cell((energy / HC_KEV_ANGSTROM) ** 2)
    low = media.incoherent[medium, cell]
    largest = low + part * (media.incoherent[medium, cell + 1] - low)
    while True:
        state, u = draw(state)
        c = 2.0 * u - 1.0
        shape, left = compton_shape(media, medium, energy, c)
        state, u = draw(state)
        if u * largest <= shape:
            return state, c, left


@njit(**OPTIONS)
def scatter_rayleigh(state, media, medium, energy):
    """Return state and cosine: x^2 by inversion of F^2's integral, (1 + c^2) / 2 by rejection."""
    most = (energy / HC_KEV_ANGSTROM) ** 2
    edges = LARGEST_X / CELLS**2
    cell, _ = _cell(most)
    q = (edges * cell * cell) ** 2
    step = (edges * (cell + 1) * (cell + 1)) ** 2 - q
    low = media.form[medium, cell]
    slope = (media.form[medium, cell + 1] - low) / step
    rest = most - q
    largest = media.form_sum[medium, cell] + rest * (low + 0.5 * slope * rest)
    while True:
        state, u = draw(state)
        wanted = u * largest
        first, last = 0, cell + 1
        while last - first > 1:
            middle = (first + last) // 2
            if media.form_sum[medium, middle] <= wanted:
                first = middle
            else:
                last = middle
        q = (edges * first * first) ** 2
        step = (edges * (first + 1) * (first + 1)) ** 2 - q
        low = media.form[medium, first]
        slope = (media.form[medium, first + 1] - low) / step
        rest = wanted - media.form_sum[medium, first]
        q += 2.0 * rest / (low + math.sqrt(max(low * low + 2.0 * slope * rest, 0.0)))
        c = max(1.0 - 2.0 * q / most, -1.0)
        state, u = draw(state)
        if 2.0 * u <= 1.0 + c * c:
            return state, c


@njit(**OPTIONS)
def turned(state, x, y, z, c):
    """Return state, and a direction at cosine ``c`` from (x, y, z), uniform about it."""
    state, u = draw(state)
    angle = 2.0 * math.pi * u
    s = math.sqrt(max(1.0 - c * c, 0.0))
    a, b = s * math.cos(angle), s * math.sin(angle)
    # Two axes beside the direction (Duff et al., J. Comput. Graph. Tech. 6, 2017).
    sign = math.copysign(1.0, z)
    k = -1.0 / (sign + z)
    m = x * y * k
    new_x = c * x + a * (1.0 + sign * x * x * k) + b * m
    new_y = c * y + a * sign * m + b * (sign + y * y * k)
    new_z = c * z - a * sign * x - b * y
    size = 1.0 / math.sqrt(new_x * new_x + new_y * new_y + new_z * new_z)
    return state, new_x * size, new_y * size, new_z * size
