"""Modulation transfer at one place in a volume, from the edge of a sphere or a wire."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from twinct.core.errors import InputError
from twinct.geometry import Floats
from twinct.geometry.arrays import lock

BINS_PER_VOXEL = 5
"""Samples of an edge spread function per voxel."""

REACH_VOXELS = 8.0
"""Largest distance from the edge, on either side, at which its spread is measured."""

_FREQUENCIES = 128


@dataclass(frozen=True, eq=False)
class Mtf:
    """Modulation transfer function.

    Attributes:
        frequency_per_mm: frequencies from 0 on, (n,), 1/mm.
        value: modulation, 1 at frequency 0, (n,).
    """

    frequency_per_mm: Floats
    value: Floats

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        lock(self, "frequency_per_mm", "value")

    def __call__(self, frequency_per_mm: ArrayLike) -> Floats:
        """Return the value at any frequencies, linearly interpolated; 0 beyond the last one."""
        f = np.asarray(frequency_per_mm, dtype=np.float64)
        return np.interp(f, self.frequency_per_mm, self.value, right=0.0)

    def falls_to(self, level: float) -> float:
        """Return the frequency at which the value first falls to a level, 1/mm, or NaN."""
        below = np.flatnonzero(self.value <= level)
        if not below.size or not below[0]:
            return math.nan
        a, b = below[0] - 1, below[0]
        share = (self.value[a] - level) / (self.value[a] - self.value[b])
        f = self.frequency_per_mm
        return float(f[a] + share * (f[b] - f[a]))


def edge_mtf(
    values: ArrayLike,
    offset_mm: ArrayLike,
    radius_mm: float,
    voxel_mm: float,
    curved: int = 2,
) -> Mtf:
    """Compute the MTF from voxels around the surface of a sphere or a cylinder.

    The values as a function of distance from the surface are the edge spread function E(t). Its
    derivative, times ((R + t) / R)^(c / 2) for a surface curved in c directions, is the line spread
    function, and the Fourier transform of this is the MTF. For a blurred sphere, S = r E(r) is an
    odd function: the unblurred one convolved with the line spread function p. Hence dE/dt = -p R /
    (R + t) up to (blur / R)^2. The cylinder's factor follows from Bessel's I1 for large arguments.
    The loss from bins and differences of width b is corrected by 1 / sinc^2(b f): Cunningham,
    Fenster, Med. Phys. 14 (1987) 533. A sphere in a CT volume: Thornton, Flynn, Proc. SPIE 6142
    (2006) 61421Z.

    Args:
        values: values of voxels, (n,), in any unit.
        offset_mm: distance of their centres from the surface, outwards positive, (n,), mm.
        radius_mm: radius of the body.
        voxel_mm: smallest edge of a voxel; the highest frequency is 1 / voxel_mm, twice the limit
            of a single line of voxels.
        curved: number of directions in which the surface is curved: 2 for a sphere, 1 for a
            cylinder, 0 for a plane.

    Raises:
        InputError: the body has no contrast, or not enough voxels.
    """
    values, offset = (np.asarray(a, dtype=np.float64).ravel() for a in (values, offset_mm))
    reach = edge_reach(radius_mm, voxel_mm)
    step = voxel_mm / BINS_PER_VOXEL
    half = int(reach / step)
    bins = np.rint(offset / step).astype(np.intp) + half
    central = (bins >= 0) & (bins <= 2 * half)
    bins, values, offset = bins[central], values[central], offset[central]
    count = np.bincount(bins, minlength=2 * half + 1)
    if half < 2 * BINS_PER_VOXEL or np.count_nonzero(count) < 0.6 * len(count):
        raise InputError(
            f"a body of radius {radius_mm:g} mm has too few voxels of {voxel_mm:g} mm around "
            "its edge for an MTF"
        )
    held = count > 0
    places, means = (
        np.bincount(bins, of, 2 * half + 1)[held] / count[held] for of in (offset, values)
    )
    at = step * np.arange(-half, half + 1)
    spread = -np.diff(np.interp(at, places, means)) / step
    # The import takes half a second, and only this work needs it.
    from scipy.signal.windows import tukey

    t = (at[1:] + at[:-1]) / 2
    spread *= ((radius_mm + t) / radius_mm) ** (curved / 2) * tukey(len(t), 0.5)
    frequency = np.linspace(0, 1 / voxel_mm, _FREQUENCIES)
    transfer = np.abs(np.exp(-2j * np.pi * frequency[:, None] * t) @ spread)
    if not transfer[0] > 0:
        raise InputError("a body without contrast has no MTF")
    return Mtf(frequency, transfer / transfer[0] / np.sinc(step * frequency) ** 2)


def edge_reach(radius_mm: float, voxel_mm: float) -> float:
    """Return the distance from the surface up to which ``edge_mtf`` uses voxels, mm."""
    return min(REACH_VOXELS * voxel_mm, radius_mm)
