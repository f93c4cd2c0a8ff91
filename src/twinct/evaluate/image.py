"""How well a reconstructed volume agrees with the truth, in the region that every view sees."""

from __future__ import annotations

import math
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from skimage.metrics import structural_similarity

from twinct.errors import InputError, TwinctError
from twinct.geometry import VolumeGrid
from twinct.threads import threads

BONE_SHARE = 0.5
"""A voxel counts as bone where its true value is at least this share of mu(bone)."""

PURE_BONE_TOLERANCE = 1e-3
"""Largest relative departure from mu(bone) of a voxel that lies entirely inside bone: far below the
1/64 that one of 4^3 supersamples weighs, far above float32 rounding."""

SSIM_WINDOW = 7
"""Edge of the cubic, uniform SSIM window in voxels: scikit-image's default."""

SLAB_PLANES = 24
"""Planes along z judged at a time: bounds the memory to a few hundred MB at 512^3."""


@dataclass(frozen=True)
class ImageFigures:
    """Image quality in a region R of voxels; mu(bone) is the true attenuation of bone.

    No voxel outside R has any influence, except that bone outside counts for the distance to bone.
    NaN where a figure has no voxels to stand on: no bone near R, or no SSIM window that fits in R.

    Attributes:
        rmse_rel: root mean square of (volume - truth) over R, relative to mu(bone).
        rmse_bone_rel: the same over the voxels of R whose centre is at most ``bone_distance_mm``
            from that of a bone voxel (true value at least 0.5 mu(bone)), bone itself included.
        psnr_db: 20 log10(mu(bone) / RMSE over R), dB; infinite for a perfect volume.
        ssim: mean 3-D structural similarity (Wang et al. 2004, K1 = 0.01, K2 = 0.03, sample
            covariance, data range mu(bone)) over all 7^3 windows that lie entirely in R.
        mean_bone_rel: mean of the volume over the voxels of R that lie entirely inside bone (true
            value mu(bone)), relative to mu(bone); 1 is right.
        roi_fraction: share of the grid's voxels that are in R.
        roi_bone_fraction: share of R's voxels that are bone voxels.
    """

    rmse_rel: float
    rmse_bone_rel: float
    psnr_db: float
    ssim: float
    mean_bone_rel: float
    roi_fraction: float
    roi_bone_fraction: float

    def as_dict(self) -> dict[str, float]:
        """The figures by name."""
        return asdict(self)


def image_figures(
    volume: ArrayLike,
    truth: ArrayLike,
    roi: ArrayLike,
    mu_reference: float,
    grid: VolumeGrid,
    bone_distance_mm: float = 3.0,
) -> ImageFigures:
    """Judge a volume against the truth; ``ImageFigures`` defines each figure.

    Args:
        volume: reconstructed attenuation, (z, y, x), 1/mm.
        truth: true attenuation (volume fraction times mu), (z, y, x), 1/mm.
        roi: the region to judge, (z, y, x), bool; see ``region_of_interest``.
        mu_reference: mu(bone), 1/mm: unit of all relative figures and data range of PSNR and SSIM.
        grid: the lattice of all three.
        bone_distance_mm: how far "near bone" reaches.

    Raises:
        InputError: the region is empty, so nothing can be judged.
        TwinctError: the volume holds values in the region that are not finite.
        ValueError: arrays that are not on the grid, or a reference that is not positive.
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
        near = _near_bone(truth, slab, BONE_SHARE * mu_reference, bone_distance_mm, grid)[inside]
        pure = np.abs(true_values - mu_reference) <= PURE_BONE_TOLERANCE * mu_reference
        ssim, windows = _ssim_sum(volume, truth, roi, box, planes, mu_reference)
        return _Sums(
            voxels=values.size,
            square=float(square.sum()),
            bone=int(np.count_nonzero(true_values >= BONE_SHARE * mu_reference)),
            near=int(np.count_nonzero(near)),
            near_square=float(square[near].sum()),
            pure=int(np.count_nonzero(pure)),
            pure_value=float(values[pure].sum()),
            windows=windows,
            ssim=ssim,
        )

    # scipy's filters let go of the interpreter lock. The sums are added in the order of the slabs:
    # the number of threads does not change the last bit.
    with ThreadPoolExecutor(min(4, threads())) as pool:
        sums = _Sums.total(pool.map(judge, _slabs(box[0])))

    rmse_rel = math.sqrt(sums.square / sums.voxels) / mu_reference
    return ImageFigures(
        rmse_rel=rmse_rel,
        rmse_bone_rel=math.sqrt(_ratio(sums.near_square, sums.near)) / mu_reference,
        psnr_db=-20 * math.log10(rmse_rel) if rmse_rel > 0 else math.inf,
        ssim=_ratio(sums.ssim, sums.windows),
        mean_bone_rel=_ratio(sums.pure_value, sums.pure) / mu_reference,
        roi_fraction=sums.voxels / roi.size,
        roi_bone_fraction=sums.bone / sums.voxels,
    )


@dataclass
class _Sums:
    """What the figures are made of, summed over voxels (or SSIM windows)."""

    voxels: int = 0
    square: float = 0.0
    bone: int = 0
    near: int = 0
    near_square: float = 0.0
    pure: int = 0
    pure_value: float = 0.0
    windows: int = 0
    ssim: float = 0.0

    @classmethod
    def total(cls, parts: Iterator[_Sums]) -> _Sums:
        """Sum of all parts, in their order."""
        total = cls()
        for part in parts:
            for name, value in vars(part).items():
                setattr(total, name, getattr(total, name) + value)
        return total


Box = tuple[slice, slice, slice]
Image = NDArray[np.floating]


def _ratio(numerator: float, denominator: int) -> float:
    return numerator / denominator if denominator else math.nan


def _bounding_box(mask: NDArray[np.bool_]) -> Box | None:
    """Smallest box that holds all that is True, or None."""
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
    """Voxels of a box at most a distance, centre to centre, from a voxel with truth >= threshold.

    The squared Euclidean distance is built up axis by axis: d2(i) <- min over k of d2(i + k) +
    (k h)^2, which is exact. As k ends at the distance asked for, a halo that wide makes it exact
    for any box.
    """
    edges = grid.voxel[::-1]
    limit = distance_mm**2 * (1 + 1e-6)  # float32 rounding must not decide at the very distance
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


def _ssim_sum(
    volume: Image, truth: Image, roi: NDArray[np.bool_], box: Box, planes: slice, data_range: float
) -> tuple[float, int]:
    """Sum of SSIM over the windows in the region centred on the planes, and their number."""
    half = SSIM_WINDOW // 2
    first, last = max(planes.start - half, box[0].start), min(planes.stop + half, box[0].stop)
    halo = (slice(first, last), *box[1:])
    inside = roi[halo]
    if min(inside.shape) < SSIM_WINDOW:
        return 0.0, 0
    whole = ndimage.minimum_filter(
        inside.view(np.uint8), size=SSIM_WINDOW, mode="constant", cval=0
    ).view(np.bool_)
    whole[: planes.start - first] = False
    whole[planes.stop - first :] = False
    count = int(np.count_nonzero(whole))
    if not count:
        return 0.0, 0
    # The filters run along whole lines: what is outside must not leak in by rounding, or as NaN.
    similarity = structural_similarity(
        np.where(inside, truth[halo], 0).astype(np.float32, copy=False),
        np.where(inside, volume[halo], 0).astype(np.float32, copy=False),
        win_size=SSIM_WINDOW,
        data_range=data_range,
        full=True,
    )[1]
    return float(similarity[whole].sum(dtype=np.float64)), count
