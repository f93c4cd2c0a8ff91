"""Agreement of a reconstructed volume with the truth in the region that every view sees."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.core.errors import InputError, TwinctError
from twinct.evaluation.bits import Bits, near, read_only, whole_windows
from twinct.evaluation.figure import has_signal, null_without_signal
from twinct.evaluation.image_words import IMAGE_FIGURES
from twinct.geometry import VolumeGrid

REFERENCE_SHARE = 0.5
"""A voxel counts as reference material if its true value is at least this share of its mu."""

PURE_TOLERANCE = 1e-3
"""Largest relative deviation from mu of a voxel that lies entirely in the reference material.

It is far below the weight of one of 4^3 supersamples, 1/64, and far above float32 rounding.
"""

WINDOW = 7
"""Edge of the cubic, uniform windows of structural similarity, in voxels."""

_STRIP = 32
"""Rows of windows that are evaluated at a time."""


@dataclass(frozen=True)
class ImageFigures:
    """Image quality in a region R of voxels; mu is the true attenuation of the reference material.

    Voxels outside R have no influence, except that reference material outside counts for the
    distance to it. A figure without voxels is NaN: without reference material near R, or without an
    SSIM window that fits in R. A volume without signal has NaN for the figures that would reward
    it, see ``Figure``.

    Attributes:
        rmse_rel: root mean square of (volume - truth) over R, relative to mu.
        rmse_near_rel: ``rmse_rel`` over the voxels of R whose centres are at most ``near_mm`` from
            the centre of a reference voxel (true value at least 0.5 mu), these voxels included.
        psnr_db: 20 log10(mu / RMSE over R), dB; infinite for a perfect volume.
        ssim: mean 3-D structural similarity (Wang et al. 2004, K1 = 0.01, K2 = 0.03, sample
            covariance, data range mu) over all 7^3 windows that lie entirely in R.
        mean_reference_rel: mean of the volume over the voxels of R that lie entirely in the
            reference material (true value mu), relative to mu; 1 is ideal.
        roi_fraction: share of the grid's voxels that are in R.
        roi_reference_fraction: share of R's voxels that are reference voxels.
        ssim_near: ``ssim`` over the windows whose centres are near, as in ``rmse_near_rel``.
        zero: figures of a volume of zeros, the baseline: ``rmse_rel``, ``rmse_near_rel``,
            ``psnr_db``, ``ssim`` and ``ssim_near``.
        further: figures of other kinds by name, nested as in ``metrics.json``.
        signal_rel: slope of the straight line that fits the volume over the truth, over R; 1 is
            ideal. An empty or constant volume has 0.
        signal_error_rel: standard error of ``signal_rel``, from the scatter about the line; the
            voxels count as independent.
    """

    rmse_rel: float
    rmse_near_rel: float
    psnr_db: float
    ssim: float
    mean_reference_rel: float
    roi_fraction: float
    roi_reference_fraction: float
    ssim_near: float = math.nan
    zero: Mapping[str, float] = field(default_factory=dict[str, float])
    further: Mapping[str, Any] = field(default_factory=dict[str, Any])
    signal_rel: float = math.nan
    signal_error_rel: float = 0.0

    def as_dict(self) -> dict[str, Any]:
        """Return the figures by name."""
        data = {name: value for name, value in vars(self).items() if name != "further"}
        return data | dict(self.further)

    def honest(self) -> ImageFigures:
        """Return the figures; without signal, NaN for those that reward it, see ``Figure``."""
        if has_signal(self.signal_rel, self.signal_error_rel):
            return self
        return ImageFigures.of(null_without_signal(self.as_dict(), IMAGE_FIGURES))

    def in_words(self, material: str) -> str:
        """Return the main figures in words, relative to a material."""
        rmse, near = (
            "no figure" if math.isnan(share) else f"{100 * share:.1f} %"
            for share in (self.rmse_rel, self.rmse_near_rel)
        )
        return f"RMSE {rmse} of mu({material}), {near} near {material}"

    @classmethod
    def of(cls, data: Mapping[str, Any]) -> ImageFigures:
        """Restore figures from the output of ``as_dict``, older versions included."""
        own = [one.name for one in fields(cls) if one.name != "further"]
        further = {name: value for name, value in data.items() if name not in own}
        return cls(**{name: data[name] for name in own if name in data}, further=further)


def image_figures(
    volume: ArrayLike,
    truth: ArrayLike,
    roi: ArrayLike,
    mu_reference: float,
    grid: VolumeGrid,
    near_mm: float = 3.0,
) -> ImageFigures:
    """Compare a volume with the truth; ``ImageFigures`` defines each figure.

    Both are rounded to float32; sums are those of float64. For several volumes of one truth,
    ``ImageReference`` computes the masks once.

    Args:
        volume: reconstructed attenuation, (z, y, x), 1/mm.
        truth: true attenuation (volume fraction times mu), (z, y, x), 1/mm.
        roi: region to evaluate, (z, y, x), bool; see ``region_of_interest``.
        mu_reference: true attenuation of the reference material, 1/mm: unit of all relative figures
            and data range of PSNR and SSIM.
        grid: the lattice of all three.
        near_mm: largest distance of voxels near the reference material.

    Raises:
        InputError: the region is empty.
        TwinctError: the volume is not finite in the region.
        ValueError: an array does not fit the grid, or the reference is not positive.
    """
    truth, roi = np.asarray(truth), np.asarray(roi, dtype=np.bool_)
    return ImageReference(truth, roi, mu_reference, grid, near_mm).figures(volume)


@dataclass(frozen=True, eq=False)
class ImageReference:
    """Truth with which volumes are compared; its masks are computed once, for any number of them.

    Attributes:
        truth: true attenuation, (z, y, x), 1/mm.
        roi: region to evaluate, (z, y, x), bool.
        mu_reference: true attenuation of the reference material, 1/mm.
        grid: the lattice of both.
        near_mm: largest distance of voxels near the reference material.
        body: voxels of a grey body that count as reference material, (z, y, x), bool;
            ``mean_reference_rel`` is then the mean in them over that of the truth. None: the
            material is uniform.
    """

    truth: NDArray[Any]
    roi: NDArray[np.bool_]
    mu_reference: float
    grid: VolumeGrid
    near_mm: float = 3.0
    body: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        """Check the arguments.

        Raises:
            InputError: the region is empty.
            ValueError: an array does not fit the grid, or the reference is not positive.
        """
        self._require_shape("truth", self.truth)
        self._require_shape("roi", self.roi)
        if self.body is not None:
            self._require_shape("body", self.body)
        mu = self.mu_reference
        if not (mu > 0 and math.isfinite(mu)):
            raise ValueError(f"mu_reference is {mu}, expected a positive attenuation in 1/mm")
        if self.near_mm < 0:
            raise ValueError(f"near_mm is {self.near_mm}, expected 0 or more")
        if not self.roi.any():
            raise InputError(
                "no voxel of the grid is seen by a view, so the image cannot be judged: move "
                "the grid into the beam, or use a larger panel or a smaller orbit"
            )

    @cached_property
    def near_reference(self) -> Bits:
        """Voxels within ``near_mm`` of a reference voxel, between centres."""
        body = self.body
        if body is None:
            voxels = Bits.where(lambda planes: self.truth[planes] >= self._least, self.grid.shape)
        else:
            voxels = Bits.where(lambda planes: body[planes], self.grid.shape)
        return near(voxels, self.near_mm, self.grid.voxel)

    @cached_property
    def windows(self) -> Bits:
        """Centres of the windows that lie entirely in the region."""
        return whole_windows(Bits.where(lambda planes: self.roi[planes], self.grid.shape), WINDOW)

    @property
    def _least(self) -> float:
        return REFERENCE_SHARE * self.mu_reference

    def figures(self, volume: ArrayLike) -> ImageFigures:
        """Compare a volume (z, y, x), 1/mm, with the truth.

        Raises:
            TwinctError: the volume is not finite in the region.
            ValueError: the volume does not fit the grid.
        """
        volume, mu = np.asarray(volume), self.mu_reference
        self._require_shape("volume", volume)
        sums = self._in_body(_VoxelSums(*self._voxel_sums(volume)), volume)
        if sums.not_finite:
            raise TwinctError("the reconstructed volume holds values that are not finite")
        windows, ssim, zero_ssim, windows_near, ssim_near, zero_near = self._window_sums(volume)
        rmse_rel = _root(sums.square, sums.voxels) / mu
        zero_rel = _root(sums.zero_square, sums.voxels) / mu
        figures = ImageFigures(
            rmse_rel=rmse_rel,
            rmse_near_rel=_root(sums.near_square, sums.near) / mu,
            psnr_db=_psnr(rmse_rel),
            ssim=_ratio(ssim, windows),
            mean_reference_rel=_ratio(sums.pure_value, sums.pure) / mu,
            roi_fraction=sums.voxels / self.roi.size,
            roi_reference_fraction=sums.reference / sums.voxels,
            ssim_near=_ratio(ssim_near, windows_near),
            signal_rel=sums.signal_rel,
            signal_error_rel=sums.signal_error_rel,
            zero={
                "rmse_rel": zero_rel,
                "rmse_near_rel": _root(sums.zero_near_square, sums.near) / mu,
                "psnr_db": _psnr(zero_rel),
                "ssim": _ratio(zero_ssim, windows),
                "ssim_near": _ratio(zero_near, windows_near),
            },
        )
        return figures.honest()

    def _in_body(self, sums: _VoxelSums, volume: NDArray[Any]) -> _VoxelSums:
        """Return the sums with the body's voxels, and the mean in them over the truth's."""
        if self.body is None:
            return sums
        inside = self.body & self.roi
        result, true = (float(a[inside].sum(dtype=np.float64)) for a in (volume, self.truth))
        mean_rel = result / true if true else math.nan
        pure_value = self.mu_reference * mean_rel
        return replace(sums, reference=float(inside.sum()), pure=1.0, pure_value=pure_value)

    def _require_shape(self, name: str, array: NDArray[Any]) -> None:
        if array.shape != self.grid.shape:
            raise ValueError(f"{name} has shape {array.shape}, the grid has {self.grid.shape}")

    def _voxel_sums(self, volume: NDArray[Any]) -> list[float]:
        from twinct.evaluation import _image

        volume, truth = (read_only(array, np.float32) for array in (volume, self.truth))
        roi, words = read_only(self.roi, np.bool_), self.near_reference.words
        out = np.empty((len(volume), len(fields(_VoxelSums))))
        mu, tolerance = float(self.mu_reference), PURE_TOLERANCE * self.mu_reference
        _image.voxel_sums(volume, truth, roi, words, mu, float(self._least), float(tolerance), out)
        return out.sum(axis=0).tolist()

    def _window_sums(self, volume: NDArray[Any]) -> list[float]:
        from twinct.evaluation import _image

        volume, truth = (read_only(array, np.float32) for array in (volume, self.truth))
        out = np.zeros((len(volume), math.ceil(volume.shape[1] / _STRIP), 6))
        c1, c2 = ((share * float(self.mu_reference)) ** 2 for share in (0.01, 0.03))
        _image.window_sums(
            volume, truth, self.near_reference.words, self.windows.words, c1, c2, out
        )
        return out.sum(axis=(0, 1)).tolist()


@dataclass(frozen=True)
class _VoxelSums:
    """Sums over voxels in the order of the kernel ``voxel_sums``."""

    voxels: float
    square: float
    near: float
    near_square: float
    reference: float
    pure: float
    pure_value: float
    zero_square: float
    zero_near_square: float
    not_finite: float
    truth: float
    volume: float
    product: float

    @property
    def signal_rel(self) -> float:
        """Slope of the line that fits the volume over the truth; NaN for a constant truth."""
        spread = self._spread
        return self._common / spread if spread > 1e-9 * self.zero_square else math.nan

    @property
    def signal_error_rel(self) -> float:
        """Standard error of this slope; NaN without it."""
        slope, degrees = self.signal_rel, self.voxels - 2
        if math.isnan(slope) or degrees < 1:
            return math.nan
        square = self.square + 2 * self.product - self.zero_square  # of the volume
        about = square - self.volume**2 / self.voxels - slope * self._common
        return math.sqrt(max(about, 0.0) / degrees / self._spread)

    @property
    def _spread(self) -> float:
        return self.zero_square - self.truth**2 / self.voxels

    @property
    def _common(self) -> float:
        return self.product - self.truth * self.volume / self.voxels


def _ratio(numerator: float, denominator: float) -> float:
    return numerator / denominator if denominator else math.nan


def _root(square: float, count: float) -> float:
    return math.sqrt(_ratio(square, count))


def _psnr(rmse_rel: float) -> float:
    return -20 * math.log10(rmse_rel) if rmse_rel > 0 else math.inf
