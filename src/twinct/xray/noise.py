"""Detector noise. Every draw takes a generator."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def quantum_noise(
    mean: NDArray[np.float32], square: NDArray[np.float32], rng: np.random.Generator
) -> NDArray[np.float32]:
    """Return the summed signal of a Poisson number of photons, each with its own signal.

    It is a scaled Poisson variable with the mean and the variance of that compound one. With the
    signal q of a photon, it is (E[q^2] / E[q]) Poisson(mean E[q] / E[q^2]). It is exact if all
    photons give an equal signal, as in ideal counting. ``mean`` is N E[q] of each pixel, ``square``
    N E[q^2].
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        signal_of_one = np.where(mean > 0, square / mean, np.float32(0))
        photons = np.where(signal_of_one > 0, mean / signal_of_one, np.float32(0))
    return (rng.poisson(photons) * signal_of_one).astype(np.float32)


def normal_noise(
    signal: NDArray[np.float32], sigma: float | NDArray[np.float32], rng: np.random.Generator
) -> NDArray[np.float32]:
    """Return the signal with normal noise of one standard deviation, for all pixels or for each."""
    draws = rng.standard_normal(signal.shape, dtype=np.float32)
    return (signal + sigma * draws).astype(np.float32, copy=False)
