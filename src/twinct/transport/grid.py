"""Anti-scatter grid: share of the photons that pass, by direction and energy.

Strips and spaces between them are crossed on straight lines. Photons that either one attenuates are
lost. The share is the exact mean of exp(-optical depth) over all places in a period of the grid, as
Day and Dance (Phys. Med. Biol. 28 (1983) 1429) derive it for parallel strips: so the image has no
lines. Strips that aim at a focal line count at each place as parallel ones of its tilt; their taper
towards the focus, a share of their height by the focal distance, is neglected.
"""

# numba cannot be typed: compiled functions take any numeric type.
# pyright: basic
from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from twinct.core.errors import InputError
from twinct.specimen.materials import Material
from twinct.transport._random import OPTIONS

PERIOD, STRIP, HEIGHT, TILT_PER_MM, ALONG_U = range(5)
"""Numbers of a grid for the kernels; a period of 0 stands for no grid."""

_LEAST_SHIFT = 1e-9
"""Shift across the strips, in periods, below which a ray counts as parallel to them."""


@dataclass(frozen=True)
class AntiScatterGrid:
    """Strips before a panel, in the middle of which they are parallel to its normal.

    Attributes:
        along: axis of the panel along which the strips run.
        ratio: height of the strips by the width of the spaces.
        period_mm: width of a strip and a space.
        strip_mm: width of a strip.
        strip: material of the strips.
        space: material between them.
        focus_mm: distance from the panel to the line at which the strips aim; infinite for parallel
            strips.
    """

    along: Literal["u", "v"]
    ratio: float
    period_mm: float
    strip_mm: float
    strip: Material
    space: Material
    focus_mm: float = math.inf

    def __post_init__(self) -> None:
        """Refuse a grid without spaces.

        Raises:
            InputError: a width, the ratio or the focal distance is out of range.
        """
        if not 0 < self.strip_mm < self.period_mm:
            raise InputError(
                f"grid: strips of {self.strip_mm:g} mm must be narrower than the period of "
                f"{self.period_mm:g} mm"
            )
        if not (self.ratio > 0 and self.focus_mm > 0):
            raise InputError(
                f"grid: ratio {self.ratio:g} and focus {self.focus_mm:g} mm must be above 0"
            )

    @property
    def height_mm(self) -> float:
        """Height of the strips."""
        return self.ratio * (self.period_mm - self.strip_mm)

    @property
    def shape(self) -> NDArray[np.float64]:
        """Numbers for the kernels."""
        along = float(self.along == "u")
        lengths = self.period_mm, self.strip_mm, self.height_mm
        return np.array([*lengths, 1 / self.focus_mm, along])

    def attenuation(self, energies_kev: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the attenuations of space and strip at some energies, (2, energies), 1/mm."""
        kinds = (self.space, self.strip)
        return np.array([[kind.mu_per_mm(float(e)) for e in energies_kev] for kind in kinds])

    def transmission(
        self,
        energies_kev: NDArray[np.float64],
        across: ArrayLike,
        along: ArrayLike,
        place_mm: ArrayLike = 0.0,
    ) -> NDArray[np.float64]:
        """Return the share of the photons that pass, (energies, ...).

        Args:
            energies_kev: photon energies, (energies,).
            across: tangent of the angle between ray and normal, across the strips.
            along: the tangent along them.
            place_mm: distance of the place from the panel's middle, across the strips.
        """
        arrays = np.broadcast_arrays(*(np.asarray(n, float) for n in (across, along, place_mm)))
        rays = np.stack([one.ravel() for one in arrays])
        shares = np.empty((len(energies_kev), rays.shape[1]))
        _transmissions(self.shape, self.attenuation(energies_kev), rays, shares)
        return shares.reshape(-1, *arrays[0].shape)


NO_GRID = np.zeros(5)
"""Numbers of a panel without a grid."""


@njit(**OPTIONS)
def passed(shape, space, strip, across, secant):
    """Return the share of photons that pass, on average over a period.

    Args:
        shape: numbers of the grid.
        space: attenuation between the strips, 1/mm.
        strip: attenuation of the strips, 1/mm.
        across: tangent of the angle between ray and strips, across them.
        secant: length of the ray by the height of the grid.
    """
    period, width = shape[PERIOD], shape[STRIP]
    length = shape[HEIGHT] * secant
    shift = max(abs(shape[HEIGHT] * across), _LEAST_SHIFT * period)
    whole = math.floor(shift / period)
    rest = shift - whole * period
    # Over a period, the part of the rest that lies in strips rises from ``least`` to ``most``.
    most = min(width, rest)
    least = max(0.0, width + rest - period)
    depth = (strip - space) * length / shift
    low, high = math.exp(-depth * least), math.exp(-depth * most)
    rising = depth * (most - least)
    between = 2.0 * (low - high) / depth if rising > 1e-6 else 2.0 * (most - least) * low
    mean = (abs(width - rest) * high + abs(period - width - rest) * low + between) / period
    return math.exp(-space * length - depth * whole * width) * mean


@njit(**OPTIONS)
def _transmissions(shape, attenuation, rays, shares):
    for n in range(rays.shape[1]):
        across, along, place = rays[0, n], rays[1, n], rays[2, n]
        secant = math.sqrt(1.0 + across * across + along * along)
        across -= place * shape[TILT_PER_MM]
        for e in range(attenuation.shape[1]):
            space, strip = attenuation[0, e], attenuation[1, e]
            shares[e, n] = passed(shape, space, strip, across, secant)
