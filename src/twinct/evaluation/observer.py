"""Detectability of a task: the observer that compares an image with the known signal."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from twinct.evaluation.nps import frequencies
from twinct.geometry import Floats

Radial = Callable[[Floats], ArrayLike]
"""Function of radial frequency, 1/mm, such as ``Mtf`` and ``Nps``."""


def detectability(
    signal: ArrayLike,
    voxel_mm: Sequence[float],
    nps: Radial | ArrayLike,
    mtf: Radial | ArrayLike = 1.0,
) -> float:
    """Return the index d' of a known signal in stationary noise, for the non-prewhitening observer.

        d'^2 = [int |W T|^2 df]^2 / int |W T|^2 NPS df,

    W being the signal's Fourier transform, T the MTF: ICRU Report 54 (1996); in cone-beam CT Gang
    et al., Med. Phys. 38 (2011) 1754. In white noise of standard deviation s, without blur, it is
    the root of the sum of the signal's squares over s.

    Args:
        signal: signal to detect, in any number d of dimensions, such as in 1/mm, with a margin of
            zeros as wide as the blur.
        voxel_mm: edges of a voxel along the array's axes, mm.
        nps: power of the noise, unit of the signal squared times mm^d: a function of the radial
            frequency, or values on the frequencies of ``numpy.fft.fftn(signal)``.
        mtf: transfer, likewise.
    """
    signal = np.asarray(signal, dtype=np.float64)
    radius = frequencies(signal.shape, voxel_mm)
    power, transfer = (np.asarray(f(radius) if callable(f) else f) for f in (nps, mtf))
    seen = np.abs(np.fft.fftn(signal) * transfer) ** 2  # 1 / V^2 times the continuous integrand
    volume = math.prod(voxel_mm)
    noise = (seen * power).sum()
    return float(seen.sum() * math.sqrt(volume / seen.size / noise)) if noise > 0 else math.inf
