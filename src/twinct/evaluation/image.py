"""Agreement of a reconstructed volume with the truth in the region that every view sees."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.core.errors import InputError, TwinctError
from twinct.core.threads import threads
from twinct.evaluation.similarity import WINDOW, similarities, whole_windows
from twinct.geometry import VolumeGrid

BONE_SHARE = 0.5
"""A voxel counts as bone if its true value is at least this share of mu(bone)."""

PURE_BONE_TOLERANCE = 1e-3
"""Largest relative deviation from mu(bone) of a voxel that lies entirely inside bone.

It is far below the weight of one of 4^3 supersamples, 1/64, and far above float32 rounding.
"""

SLAB_PLANES = 24
"""Planes along z evaluated at a time: this limits the memory to a few hundred MB at 512^3."""


@dataclass(frozen=True)
class ImageFigures:
    """Image quality in a region R of voxels; mu(bone) is the true attenuation of bone.

    Voxels outside R have no influence, except that bone outside counts for the distance to bone. A
    figure without voxels is NaN: without bone near R, or without an SSIM window that fits in R.

    Attributes:
        rmse_rel: root mean square of (volume - truth) over R, relative to mu(bone).
        rmse_bone_rel: ``rmse_rel`` over the voxels of R whose centres are at most
            ``bone_distance_mm`` from the centre of a bone voxel (true value at least 0.5 mu(bone)),
            bone itself included.
        psnr_db: 20 log10(mu(bone) / RMSE over R), dB; infinite for a perfect volume.
        ssim: mean 3-D structural similarity (Wang et al. 2004, K1 = 0.01, K2 = 0.03, sample
            covariance, data range mu(bone)) over all 7^3 windows that lie entirely in R.
        mean_bone_rel: mean of the volume over the voxels of R that lie entirely inside bone (true
            value mu(bone)), relative to mu(bone); 1 is ideal.
        roi_fraction: share of the grid's voxels that are in R.
        roi_bone_fraction: share of R's voxels that are bone voxels.
        ssim_bone: ``ssim`` over the windows whose centres are near bone, as in ``rmse_bone_rel``.
        zero: figures of a volume of zeros, the baseline: ``rmse_rel``, ``rmse_bone_rel``,
            ``psnr_db``, ``ssim`` and ``ssim_bone``.
        further: figures of other kinds by name, nested as in ``metrics.json``.
    """

    rmse_rel: float
    rmse_bone_rel: float
    psnr_db: float
    ssim: float
    mean_bone_rel: float
    roi_fraction: float
    roi_bone_fraction: float
    ssim_bone: float = math.nan
    zero: Mapping[str, float] = field(default_factory=dict[str, float])
    further: Mapping[str, Any] = field(default_factory=dict[str, Any])

    def as_dict(self) -> dict[str, Any]:
        """Return the figures by name."""
        told = {name: value for name, value in vars(self).items() if name != "further"}
        return told | dict(self.further)

    @classmethod
    def of(cls, told: Mapping[str, Any]) -> ImageFigures:
        """Restore figures from the output of ``as_dict``, older versions included."""
        own = [one.name for one in fields(cls) if one.name != "further"]
        further = {name: value for name, value in told.items() if name not in own}
        return cls(**{name: told[name] for name in own if name in told}, further=further)


def image_figures(
    volume: ArrayLike,
    truth: ArrayLike,
    roi: ArrayLike,
    mu_reference: float,
    grid: VolumeGrid,
    bone_distance_mm: float = 3.0,
) -> ImageFigures:
    """Compare a volume with the truth; ``ImageFigures`` defines each figure.

    Args:
        volume: reconstructed attenuation, (z, y, x), 1/mm.
        truth: true attenuation (volume fraction times mu), (z, y, x), 1/mm.
        roi: region to evaluate, (z, y, x), bool; see ``region_of_interest``.
        mu_reference: mu(bone), 1/mm: unit of all relative figures and data range of PSNR and SSIM.
        grid: the lattice of all three.
        bone_distance_mm: largest distance of voxels "near bone".

    Raises:
        InputError: the region is empty.
        TwinctError: the volume is not finite in the region.
        ValueError: an array does not fit the grid, or the reference is not positive.
    """
    volume, truth, roi = np.asarray(volume), np.asarray(truth), np.asarray(roi, dtype=np.bool_)
    for name, array in (("volume", volume), ("truth", truth), ("roi", roi)):
        if array.shape != grid.shape:
            raise ValueError(f"{name} has shape {array.shape}, the grid has {grid.shape}")
    if not (mu_reference > 0 and math.isfinite(mu_reference)):
        raise ValueError(f"mu_reference is {mu_reference}, expected a positive attenuation in 1/mm")
    if bone_distance_mm < 0:
        raise ValueError(f"bone_distance_mm is {bone_distance_mm}, expected 0 or more")
    box = _bounding_box(roi)
    if box is None:
        raise InputError(
            "no voxel of the grid is seen by every view, so the image cannot be judged: move the "
            "grid into the beam, or use a larger panel or a smaller orbit"
        )

    def judge(planes: slice) -> _Sums:
        slab = (planes, *box[1:])
        inside = roi[slab]
        values = volume[slab][inside].astype(np.float64)
        if not np.isfinite(values).all():
            raise TwinctError("the reconstructed volume holds values that are not finite")
        true_values = truth[slab][inside].astype(np.float64)
        square = (values - true_values) ** 2
        near_bone = _near_bone(truth, slab, BONE_SHARE * mu_reference, bone_distance_mm, grid)
        near = near_bone[inside]
        pure = np.abs(true_values - mu_reference) <= PURE_BONE_TOLERANCE * mu_reference
        return _Sums(
            voxels=values.size,
            square=float(square.sum()),
            bone=int(np.count_nonzero(true_values >= BONE_SHARE * mu_reference)),
            near=int(np.count_nonzero(near)),
            near_square=float(square[near].sum()),
            pure=int(np.count_nonzero(pure)),
            pure_value=float(values[pure].sum()),
            zero_square=float((true_values**2).sum()),
            zero_near_square=float((true_values[near] ** 2).sum()),
            **_ssim_sums(volume, truth, roi, box, planes, near_bone, mu_reference),
        )

    # scipy's filters release the interpreter lock. The sums are added in the order of the slabs, so
    # that the number of threads does not change the last bit.
    with ThreadPoolExecutor(min(4, threads())) as pool:
        sums = _Sums.total(pool.map(judge, _slabs(box[0])))

    rmse_rel = math.sqrt(sums.square / sums.voxels) / mu_reference
    zero_rel = math.sqrt(sums.zero_square / sums.voxels) / mu_reference
    return ImageFigures(
        rmse_rel=rmse_rel,
        rmse_bone_rel=math.sqrt(_ratio(sums.near_square, sums.near)) / mu_reference,
        psnr_db=_psnr(rmse_rel),
        ssim=_ratio(sums.ssim, sums.windows),
        mean_bone_rel=_ratio(sums.pure_value, sums.pure) / mu_reference,
        roi_fraction=sums.voxels / roi.size,
        roi_bone_fraction=sums.bone / sums.voxels,
        ssim_bone=_ratio(sums.ssim_near, sums.windows_near),
        zero={
            "rmse_rel": zero_rel,
            "rmse_bone_rel": math.sqrt(_ratio(sums.zero_near_square, sums.near)) / mu_reference,
            "psnr_db": _psnr(zero_rel),
            "ssim": _ratio(sums.zero_ssim, sums.windows),
            "ssim_bone": _ratio(sums.zero_ssim_near, sums.windows_near),
        },
    )


@dataclass
class _Sums:
    """Sums over voxels (or SSIM windows) from which the figures are computed."""

    voxels: int = 0
    square: float = 0.0
    bone: int = 0
    near: int = 0
    near_square: float = 0.0
    pure: int = 0
    pure_value: float = 0.0
    windows: int = 0
    ssim: float = 0.0
    zero_ssim: float = 0.0
    windows_near: int = 0
    ssim_near: float = 0.0
    zero_ssim_near: float = 0.0
    zero_square: float = 0.0
    zero_near_square: float = 0.0

    @classmethod
    def total(cls, parts: Iterator[_Sums]) -> _Sums:
        """Return the sum of all parts, added in their order."""
        total = cls()
        for part in parts:
            for name, value in vars(part).items():
                setattr(total, name, getattr(total, name) + value)
        return total


Box = tuple[slice, slice, slice]
Image = NDArray[np.floating]


def _ratio(numerator: float, denominator: int) -> float:
    return numerator / denominator if denominator else math.nan


def _psnr(rmse_rel: float) -> float:
    return -20 * math.log10(rmse_rel) if rmse_rel > 0 else math.inf


def _bounding_box(mask: NDArray[np.bool_]) -> Box | None:
    """Return the smallest box that contains all True voxels, or None."""
    bounds: list[slice] = []
    for others in ((1, 2), (0, 2), (0, 1)):
        hits = np.flatnonzero(np.any(mask, axis=others))
        if not hits.size:
            return None
        bounds.append(slice(int(hits[0]), int(hits[-1]) + 1))
    return bounds[0], bounds[1], bounds[2]


def _slabs(planes: slice) -> Iterator[slice]:
    for start in range(planes.start, planes.stop, SLAB_PLANES):
        yield slice(start, min(start + SLAB_PLANES, planes.stop))


def _near_bone(
    truth: Image, box: Box, threshold: float, distance_mm: float, grid: VolumeGrid
) -> NDArray[np.bool_]:
    """Return the mask of a box's voxels within ``distance_mm`` of a voxel with truth >= threshold.

    Distances are between centres. The squared distance is built up axis by axis: d2(i) <- min over
    k of d2(i + k) + (k h)^2, which is exact. Since k ends at the requested distance, a halo of that
    width makes it exact for any box.
    """
    edges = grid.voxel[::-1]
    limit = distance_mm**2 * (1 + 1e-6)  # float32 rounding must not decide at the limit itself
    reach = [int(math.sqrt(limit) / edge) for edge in edges]
    halo = tuple(
        slice(max(s.start - r, 0), min(s.stop + r, n))
        for s, r, n in zip(box, reach, truth.shape, strict=True)
    )
    far = np.float32(np.inf)
    square = np.where(truth[halo] >= threshold, np.float32(0), far)
    for axis in (2, 1, 0):
        lines = np.moveaxis(square, axis, 0)
        nearest = lines.copy()
        for k in range(1, min(reach[axis], len(lines) - 1) + 1):
            cost = np.float32((k * edges[axis]) ** 2)
            shifted = lines + cost
            np.minimum(nearest[k:], shifted[:-k], out=nearest[k:])
            np.minimum(nearest[:-k], shifted[k:], out=nearest[:-k])
        inner = slice(box[axis].start - halo[axis].start, box[axis].stop - halo[axis].start)
        square = np.ascontiguousarray(np.moveaxis(nearest[inner], 0, axis))
    return square <= limit


def _ssim_sums(
    volume: Image,
    truth: Image,
    roi: NDArray[np.bool_],
    box: Box,
    planes: slice,
    near: NDArray[np.bool_],
    data_range: float,
) -> dict[str, Any]:
    """Return the sums of SSIM over the region's windows centred on the planes, and counts."""
    half = WINDOW // 2
    first, last = max(planes.start - half, box[0].start), min(planes.stop + half, box[0].stop)
    halo = (slice(first, last), *box[1:])
    inside = roi[halo]
    centres = whole_windows(inside)
    centres[: planes.start - first] = False
    centres[planes.stop - first :] = False
    count = int(np.count_nonzero(centres))
    if not count:
        return {}
    # The filters run along whole lines: rounding must not leak in from outside, nor must NaN.
    ssim, zero = similarities(
        np.where(inside, truth[halo], 0).astype(np.float32, copy=False),
        np.where(inside, volume[halo], 0).astype(np.float32, copy=False),
        centres,
        data_range,
    )
    own = slice(planes.start - first, planes.stop - first)
    at = near[centres[own]]
    return {
        "windows": count,
        "ssim": float(ssim.sum(dtype=np.float64)),
        "zero_ssim": float(zero.sum(dtype=np.float64)),
        "windows_near": int(np.count_nonzero(at)),
        "ssim_near": float(ssim[at].sum(dtype=np.float64)),
        "zero_ssim_near": float(zero[at].sum(dtype=np.float64)),
    }
