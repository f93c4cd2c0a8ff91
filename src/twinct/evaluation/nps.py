"""Noise power spectra."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.geometry import Floats
from twinct.geometry.arrays import lock


@dataclass(frozen=True, eq=False)
class Nps:
    """Radial noise power spectrum in d dimensions.

    Attributes:
        frequency_per_mm: mean of each bin, from 0 on, (n,), 1/mm.
        value: power, (n,), unit of the values squared times mm^d.
        share: volume of frequency space in each bin, (n,), 1/mm^d.
    """

    frequency_per_mm: Floats
    value: Floats
    share: Floats

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        lock(self, "frequency_per_mm", "value", "share")

    def __call__(self, frequency_per_mm: ArrayLike) -> Floats:
        """Return the value at any frequencies: linearly interpolated, and constant beyond the ends.

        The bin at frequency 0 is excluded: removing the mean or a trend removed its power.
        """
        f = np.asarray(frequency_per_mm, dtype=np.float64)
        return np.interp(f, self.frequency_per_mm[1:], self.value[1:])

    @classmethod
    def averaged(cls, spectra: Sequence[Nps]) -> Nps:
        """Average the spectra of regions of one shape, which reduces their uncertainty."""
        value = np.mean([one.value for one in spectra], axis=0)
        return cls(spectra[0].frequency_per_mm, value, spectra[0].share)

    @property
    def variance(self) -> float:
        """Integral of the spectrum."""
        return float(self.value @ self.share)

    @property
    def mean_frequency_per_mm(self) -> float:
        """Mean frequency, weighted by the power, 1/mm: fineness of the noise; NaN without power."""
        power = self.value * self.share
        return float(self.frequency_per_mm @ power / power.sum()) if power.any() else math.nan


def frequencies(shape: Sequence[int], voxel_mm: Sequence[float]) -> Floats:
    """Return the radial frequency of each term of an array's discrete Fourier transform, 1/mm."""
    axes = [np.fft.fftfreq(n, edge) for n, edge in zip(shape, voxel_mm, strict=True)]
    return np.sqrt(sum(f**2 for f in np.meshgrid(*axes, indexing="ij")))


def noise_power_spectrum(
    noise: ArrayLike, voxel_mm: Sequence[float], mask: NDArray[np.bool_] | None = None
) -> Nps:
    """Compute the radial power spectrum of noise; its integral is the noise's mean square.

    With voxels of volume V, NPS(f) = V |sum_k w_k n_k exp(-2 pi i f . x_k)|^2 / sum_k w_k^2, with
    the mask w: ICRU Report 87 (2012). Values are averaged in bins as wide as the coarsest frequency
    resolution of the axes.

    Args:
        noise: values without their expectation, in any number d of dimensions: see ``detrended``,
            or half the difference of two volumes times the square root of 2.
        voxel_mm: edges of a voxel along the array's axes, mm.
        mask: voxels to include, all by default. Its spectrum smears the spectrum of the noise.
    """
    noise = np.asarray(noise, dtype=np.float64)
    counted = noise.size if mask is None else np.count_nonzero(mask)
    noise = noise if mask is None else np.where(mask, noise, 0.0)
    power = np.abs(np.fft.fftn(noise)) ** 2 * (math.prod(voxel_mm) / counted)
    extent = np.array(noise.shape) * np.asarray(voxel_mm)
    radius = frequencies(noise.shape, voxel_mm).ravel()
    bins = np.rint(radius * extent.min()).astype(np.intp)
    count = np.bincount(bins)
    held = count > 0
    value, frequency = (np.bincount(bins, of)[held] / count[held] for of in (power.ravel(), radius))
    return Nps(frequency, value, count[held] / extent.prod())


def detrended(values: ArrayLike, mask: NDArray[np.bool_] | None = None, order: int = 2) -> Floats:
    """Return values less their best-fitting polynomial of an order along all axes.

    The rest of a homogeneous region is its noise. Outside the mask, if there is one, it is 0.
    """
    values = np.asarray(values, dtype=np.float64)
    inside = np.ones(values.shape, dtype=np.bool_) if mask is None else mask
    places = [np.linspace(-1, 1, n) if n > 1 else np.zeros(1) for n in values.shape]
    axes = [grid[inside] for grid in np.meshgrid(*places, indexing="ij")]
    powers = [p for p in np.ndindex(*[order + 1] * values.ndim) if sum(p) <= order]
    terms = np.stack([math.prod(a**n for a, n in zip(axes, p, strict=True)) for p in powers])
    # Normal equations: a region may have millions of voxels, the terms are few and of one size.
    weights = np.linalg.lstsq(terms @ terms.T, terms @ values[inside], rcond=None)[0]
    left = np.zeros(values.shape)
    left[inside] = values[inside] - weights @ terms
    return left
