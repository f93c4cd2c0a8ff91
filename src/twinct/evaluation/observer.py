"""Detectability of a task: the observer that compares volumes with the mean image of a signal.

The observer is the non-prewhitening one. It knows the signal's mean image s in the volume, with all
that the scan and the reconstruction do to it, and its response to a volume x is t = w . x with the
template w = s. Over volumes with and without the signal,

    d'^2 = (mean t with - mean t without)^2 / ((variance with + variance without) / 2)

(ICRU Report 54 (1996); Barrett and Myers, Foundations of Image Science (2004), sections 13.2 and
14.3; in cone-beam CT Gang et al., Med. Phys. 38 (2011) 1754). With the covariance K of the volume
this is w . s / sqrt(w . K w). The variance has three parts:

- quantum noise: between scans that differ in their noise alone;
- texture: of the mean of these scans, from place to place in a region. Streaks of few views are
  equal in all scans, so that differences of scans would not show them;
- shift: of the response to the signal, over its positions within a voxel.

No trend is removed: blur leaves the low frequencies of the noise, and the observer sees them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import Floats

COVERAGE = 0.95
"""Probability with which an interval holds the detectability."""


@dataclass(frozen=True)
class DetectabilityIndex:
    """Detectability index d' with its interval, and that of quantum noise alone.

    Attributes:
        value: d' in quantum noise, texture and shift; without both it exceeds ``quantum`` in every
            second case, by chance.
        low: lower end of the interval of ``COVERAGE`` for ``value``.
        high: upper end.
        quantum: d' in quantum noise alone; infinite without noise.
    """

    value: float
    low: float
    high: float
    quantum: float


def detectability(
    signals: Floats, volumes: Sequence[NDArray[np.floating]], places: NDArray[np.bool_]
) -> DetectabilityIndex:
    """Return d' of a signal from repeated volumes.

    The interval is that of a variance with as many independent values as the correlation of the
    responses from place to place leaves (Satterthwaite, Biometrics Bull. 2 (1946) 110); the mean
    image of the signal, in which equal noise cancels, counts as known.

    Args:
        signals: volume with the signal less the volume without, of equal noise, about each of its
            positions, (positions, z, y, x), with an odd number of voxels along each axis; 0 where
            the template shall see nothing.
        volumes: volumes without the signal, less their expectation if it is known, from scans with
            noise of their own, (z, y, x) each.
        places: voxels in whose surroundings the signal might lie, (z, y, x); the size of a signal
            less than the volumes along each axis. ``places[0, 0, 0]`` is the middle of the first
            signal that fits into the volumes.

    Returns:
        NaN without signal or without places; infinite if nothing varies.
    """
    template = signals.mean(axis=0)
    raised, shift = _raised(signals, template)
    responses = np.array([_responses(volume, template) for volume in volumes])
    mean = responses.mean(axis=0)
    scans, count = len(volumes), int(places.sum())
    if not (raised > 0 and count):
        return DetectabilityIndex(*[math.nan] * 4)
    quantum, of_quantum = 0.0, math.inf
    if scans > 1:
        apart = responses - mean
        quantum = float((apart[:, places] ** 2).sum()) / ((scans - 1) * count)
        of_quantum = (scans - 1) * _independent(apart, places, signals.shape[1:])
    about = mean - mean[places].mean()
    spread = float((about[places] ** 2).mean())
    # Texture may come out below 0 by chance: cut off at 0, it would lower d' in the mean.
    texture = spread - quantum / scans
    variance = quantum + texture + shift / 2
    if not variance > 0:
        return DetectabilityIndex(*[math.inf] * 4)
    of_spread = _independent(about[None], places, signals.shape[1:])
    # Variances of the variances; that of the spread holds what is left of the noise in the mean.
    certain = (quantum * (1 - 1 / scans)) ** 2 / of_quantum + spread**2 / of_spread
    if len(signals) > 1:
        certain += (shift / 2) ** 2 / (len(signals) - 1)
    value = raised / math.sqrt(variance)
    low, high = _interval(variance**2 / certain if certain > 0 else math.inf)
    alone = raised / math.sqrt(quantum) if quantum > 0 else math.inf
    return DetectabilityIndex(value, value * low, value * high, alone)


def _raised(signals: Floats, template: Floats) -> tuple[float, float]:
    """Return by how much the signal raises the mean response, and the variance over positions.

    Each position is compared with the others, so that noise in one image does not raise its own
    response.
    """
    count = len(signals)
    own = np.einsum("nzyx,nzyx->n", signals, signals)
    if count == 1:
        return float(own[0]), 0.0
    others = (count * np.einsum("nzyx,zyx->n", signals, template) - own) / (count - 1)
    return float(others.mean()), float(others.var(ddof=1))


def _responses(volume: NDArray[np.floating], template: Floats) -> Floats:
    """Return w . x with the template at each place where it fits into a volume."""
    from scipy.signal import fftconvolve

    turned = template[::-1, ::-1, ::-1]
    return np.asarray(fftconvolve(np.asarray(volume, np.float64), turned, mode="valid"))


def _independent(values: Floats, places: NDArray[np.bool_], size: tuple[int, ...]) -> float:
    """Return the number of independent values that give a mean square as certain as these places.

    n^2 / sum over pairs of places of rho^2 for normal values with the correlation rho, which is
    estimated from the values themselves, (scans, z, y, x), up to the template's size.
    """
    shape = [n + m for n, m in zip(places.shape, size, strict=True)]
    inside = np.abs(np.fft.rfftn(places.astype(np.float64), shape, axes=(0, 1, 2))) ** 2
    pairs = np.fft.irfftn(inside, shape, axes=(0, 1, 2))
    power = np.zeros(inside.shape)
    for one in values:
        power += np.abs(np.fft.rfftn(np.where(places, one, 0.0), shape, axes=(0, 1, 2))) ** 2
    products = np.fft.irfftn(power, shape, axes=(0, 1, 2))
    if not products[0, 0, 0] > 0:
        return math.inf
    near = np.ix_(*(np.r_[0:m, n - m + 1 : n] for n, m in zip(shape, size, strict=True)))
    pairs, products = np.rint(pairs[near]), products[near]
    known = pairs > 0
    rho = products[known] / pairs[known] / (products[0, 0, 0] / pairs[0, 0, 0])
    return float(pairs[0, 0, 0] ** 2 / (pairs[known] * rho**2).sum())


def _interval(degrees: float) -> tuple[float, float]:
    """Return the ends of the interval of 1 / sqrt(variance), relative to the estimate."""
    from scipy.special import gammaincinv

    if not math.isfinite(degrees):
        return 1.0, 1.0
    tails = (1 - COVERAGE) / 2, (1 + COVERAGE) / 2
    low, high = (math.sqrt(2 * gammaincinv(degrees / 2, p) / degrees) for p in tails)
    return low, high
