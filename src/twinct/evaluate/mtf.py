"""Modulation transfer at one place of a volume, from the edge of a sphere or a wire."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from twinct.errors import InputError
from twinct.geometry import Floats
from twinct.geometry.arrays import lock

BINS_PER_VOXEL = 5
"""Samples of an edge spread function per voxel."""

REACH_VOXELS = 8.0
"""As far on either side of the edge its spread is looked at, where the body has room for it."""

_FREQUENCIES = 128


@dataclass(frozen=True, eq=False)
class Mtf:
    """A modulation transfer function.

    Attributes:
        frequency_per_mm: from 0 on, (n,), 1/mm.
        value: 1 at frequency 0, (n,).
    """

    frequency_per_mm: Floats
    value: Floats

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        lock(self, "frequency_per_mm", "value")

    def __call__(self, frequency_per_mm: ArrayLike) -> Floats:
        """Its value at any frequencies, linearly interpolated; 0 beyond the last."""
        f = np.asarray(frequency_per_mm, dtype=np.float64)
        return np.interp(f, self.frequency_per_mm, self.value, right=0.0)

    def falls_to(self, level: float) -> float:
        """Frequency at which it first falls to a level, 1/mm; NaN where it does not."""
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
    """MTF from voxels about the surface of a sphere or a cylinder.

    Their values over the distance from the surface are the edge spread function E(t); its
    derivative, times ((R + t) / R)^(c / 2) as the surface is curved in c directions, is the line
    spread function, whose Fourier transform is the MTF. With S = r E(r) of a blurred sphere, an odd
    function that is the unblurred one's convolved with the line spread function p, one finds
    dE/dt = -p R / (R + t) up to (blur / R)^2; the cylinder's follows from Bessel's I1 for large
    arguments. What bins and differences of width b take is given back as 1 / sinc^2(b f):
    Cunningham, Fenster, Med. Phys. 14 (1987) 533. A sphere in a CT volume: Thornton, Flynn, Proc.
    SPIE 6142 (2006) 61421Z.

    Args:
        values: of voxels, (n,), in any unit.
        offset_mm: distance of their centres from the surface, outwards positive, (n,), mm.
        radius_mm: of the body.
        voxel_mm: the smallest edge of a voxel; the highest frequency is 1 / voxel_mm, twice
            what a single line of voxels could tell.
        curved: directions in which the surface is curved: 2 for a sphere, 1 for a cylinder, 0 for a
            plane.

    Raises:
        InputError: the body has no contrast, or not enough voxels.
    """
    values, offset = (np.asarray(a, dtype=np.float64).ravel() for a in (values, offset_mm))
    reach = edge_reach(radius_mm, voxel_mm)
    step = voxel_mm / BINS_PER_VOXEL
    half = int(reach / step)
    bins = np.rint(offset / step).astype(np.intp) + half
    kept = (bins >= 0) & (bins <= 2 * half)
    bins, values, offset = bins[kept], values[kept], offset[kept]
    count = np.bincount(bins, minlength=2 * half + 1)
    if half < 2 * BINS_PER_VOXEL or np.count_nonzero(count) < 0.6 * len(count):
        raise InputError(
            f"a body of radius {radius_mm:g} mm has too few voxels of {voxel_mm:g} mm about its "
            "edge for an MTF"
        )
    held = count > 0
    places, means = (
        np.bincount(bins, of, 2 * half + 1)[held] / count[held] for of in (offset, values)
    )
    at = step * np.arange(-half, half + 1)
    spread = -np.diff(np.interp(at, places, means)) / step
    # Half a second to import: no other work waits for it.
    from scipy.signal.windows import tukey

    t = (at[1:] + at[:-1]) / 2
    spread *= ((radius_mm + t) / radius_mm) ** (curved / 2) * tukey(len(t), 0.5)
    frequency = np.linspace(0, 1 / voxel_mm, _FREQUENCIES)
    transfer = np.abs(np.exp(-2j * np.pi * frequency[:, None] * t) @ spread)
    if not transfer[0] > 0:
        raise InputError("a body without contrast has no MTF")
    return Mtf(frequency, transfer / transfer[0] / np.sinc(step * frequency) ** 2)


def edge_reach(radius_mm: float, voxel_mm: float) -> float:
    """Distance from the surface up to which ``edge_mtf`` takes voxels, mm."""
    return min(REACH_VOXELS * voxel_mm, radius_mm)
