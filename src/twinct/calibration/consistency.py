"""Geometry from the specimen's projections alone: each view is moved until it agrees with all.

Two steps alternate: a volume is reconstructed with the current geometry, and each view's source and
panel (or the patient between them) are moved so that the volume's line integrals match the measured
ones (registration of projections to a volume, as in Ouadah et al., Phys. Med. Biol. 61 (2016) 2613,
but with the scan's own volume). A rigid motion of the whole scene and its scale change no
projection. Only the prior, errors about zero, determines these seven modes: they stay where they
were believed. (For a moving patient there are six, as the SDD is fixed.)

The volume has to fit the projections as closely as possible. Only for the best volume is the
derivative of the smallest residual by the poses equal to the one at a fixed volume (envelope
theorem; Golub and Pereyra, SIAM J. Numer. Anal. 10 (1973) 413). The misfit after a few passes of
SART pulls errors that are similar over many views away from the truth, and more so with every
round.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinct.calibration.freedom import Freedom, PosePrior, What
from twinct.core.errors import InputError
from twinct.core.progress import SILENT, Progress
from twinct.geometry import Floats, ScanGeometry, VolumeGrid
from twinct.recon import Projector, sart
from twinct.recon.checks import start_volume
from twinct.recon.fista import Variation, minimised
from twinct.recon.order import subset_number
from twinct.recon.ray_slopes import slopes_along
from twinct.recon.resolution import binned, interpolated
from twinct.recon.volume import Volume

ROBUST = 1.5
"""Residuals above so many standard deviations pull like one at this threshold (Huber)."""

ALIKE_PX = 12.0
"""Number of neighbouring pixels that count as one, because their residuals are correlated."""

CLOSENESS = 1e-3
"""Regularisation relative to the volume's mean attenuation, weighted by itself: next to none."""

DUAL_STEPS = 10
"""Steps of the dual iteration in each update, as in ``prior_tv``."""

MOMENTUM = 0.5
"""Share of a round's change that the next repeats: a volume that fits gives way slowly."""

SMALLEST = 16
"""Minimum number of pixels and voxels along each axis for a round."""


@dataclass(frozen=True)
class Round:
    """One reconstruction and the pose update after it.

    Attributes:
        factor: binning factor of pixels and voxels.
        passes: passes over all views; each round continues from the volume before.
    """

    factor: int
    passes: int = 4


ROUNDS = (*[Round(4)] * 4, *[Round(2)] * 4)

FROM_START = ROUNDS[4:]
"""Rounds after a start from plane integrals: coarse rounds would lead away from such a start."""

FEW_PIXELS = (Round(1),) * 4
"""Rounds for images that are too small for any of the requested rounds."""


@dataclass(frozen=True, eq=False)
class SelfCalibration:
    """Geometry of a scan, estimated from its own projections.

    Attributes:
        geometry: geometry of all views.
        change: change from the believed geometry. For arms, ``resection.PARAMETERS``, (views, 9).
            For a patient, the motion of source and panel in the patient's frame, as a twist (v, w)
            about the middle of the grid, world axes, (views, 6), mm and rad.
        residuals: spread of measured minus projected line integrals, before each round's update.
    """

    geometry: ScanGeometry
    change: Floats
    residuals: tuple[float, ...]


def self_calibrated(
    line_integrals: NDArray[np.float32],
    believed: ScanGeometry,
    grid: VolumeGrid,
    prior: PosePrior,
    *,
    what: What = "arms",
    rounds: Sequence[Round] | None = None,
    mask: NDArray[np.bool_] | None = None,
    start: Floats | None = None,
    progress: Progress = SILENT,
) -> SelfCalibration:
    """Move each view until projections and reconstruction agree.

    Args:
        line_integrals: (views, rows, columns).
        believed: approximate geometry.
        grid: full-resolution grid that holds the specimen.
        prior: prior on the errors.
        what: moving part; for a patient, the resulting geometry is relative to the patient.
        rounds: rounds from coarse to fine. Default: ``ROUNDS``, or ``FROM_START`` with a start.
            Rounds that leave too few pixels or voxels are skipped; if none is left, four rounds at
            full resolution run.
        mask: True where a pixel counts, (rows, columns) or (views, rows, columns).
        start: initial changes, as in ``SelfCalibration.change``, such as those from
            ``epipolar_consistent``; zero by default. The prior still refers to the believed
            geometry.
        progress: receives a step for each round.

    Raises:
        InputError: ``start`` has another number of views or parameters.
    """
    free = Freedom(what, grid.world_from_grid.position)
    size = len(free.steps)
    change = np.zeros((len(believed), size)) if start is None else start
    if change.shape != (len(believed), size):
        raise InputError(f"start has shape {change.shape}; it must be {(len(believed), size)}")
    precision = prior.precision(len(believed), what)
    residuals: list[float] = []
    volume: Volume | None = None
    before = change
    smallest = min(*grid.shape, *line_integrals.shape[1:])
    if rounds is None:
        rounds = ROUNDS if start is None else FROM_START
    rounds = [one for one in rounds if smallest // one.factor >= SMALLEST] or FEW_PIXELS
    with progress.stage("self-calibration", len(rounds)) as step:
        for one in rounds:
            p, counts = binned(line_integrals, mask, (one.factor, one.factor))
            coarse = grid.with_voxels(one.factor * grid.voxel)
            geometry = free.all(believed, change)
            A = Projector(geometry.binned(one.factor, one.factor), coarse)
            volume = _fitted(A, p, counts, one.passes, volume)
            normal, right, spread = _normal_equations(
                volume.array, p, counts, believed, free, change, coarse, one.factor
            )
            residuals.append(spread)
            step_on = _newton_step(precision, normal, right, change)
            before, change = change, change + step_on + MOMENTUM * (change - before)
            step()
    return SelfCalibration(free.all(believed, change), change, tuple(residuals))


def _newton_step(precision: Floats, normal: Floats, right: Floats, change: Floats) -> Floats:
    """Solve the normal equations of all views, with the prior's precision, (views, n)."""
    views, size = change.shape
    hessian = precision.copy()
    for view in range(views):
        own = slice(size * view, size * view + size)
        hessian[own, own] += normal[view]
    pull = right.ravel() - precision @ change.ravel()
    return np.asarray(np.linalg.solve(hessian, pull), np.float64).reshape(change.shape)


def _fitted(
    A: Projector,
    p: NDArray[np.float32],
    counts: NDArray[np.bool_] | None,
    passes: int,
    before: Volume | None,
) -> Volume:
    """Return the best-fitting volume, starting from the previous one or from one pass of SART."""
    if before is None:
        start = sart(A, p, iterations=1, relaxation=0.3, nonnegative=True, mask=counts).array
    else:
        start = before.array
        if before.grid.shape != A.grid.shape:
            start = interpolated(start, before.grid, A.grid)
    mass = float(start.sum(dtype=np.float64))
    mean = float(np.square(start, dtype=np.float64).sum()) / mass if mass > 0 else 0.0
    variation = Variation(A, CLOSENESS * mean, DUAL_STEPS, np.float32(0))
    subsets = subset_number(None, len(A))
    start = start_volume(A, start, nonnegative=True)
    return minimised(A, p, start, variation, iterations=passes, subsets=subsets, mask=counts)


def _normal_equations(
    x: NDArray[np.float32],
    p: NDArray[np.float32],
    counts: NDArray[np.bool_] | None,
    believed: ScanGeometry,
    free: Freedom,
    change: Floats,
    grid: VolumeGrid,
    factor: int,
) -> tuple[Floats, Floats, float]:
    """Return normal matrices, (views, n, n), right sides, (views, n), and the residuals' spread."""
    size = len(free.steps)
    geometry = free.all(believed, change).binned(factor, factor)
    A, tangents = Projector(geometry, grid), free.tangents(believed, change, factor)
    lengths = A.chords()
    rests: list[Floats] = []
    slopes: list[Floats] = []
    for view, (image, length) in enumerate(zip(A(x), lengths, strict=True)):
        seen = length > 0
        if counts is not None:
            seen &= counts if counts.ndim == 2 else counts[view]
        rests.append((p[view] - image)[seen].astype(np.float64))
        slopes.append(slopes_along(A, x, view, tangents[view])[:, seen].T)
    pooled = np.concatenate(rests)
    spread = 1.4826 * float(np.median(np.abs(pooled)))
    spread = max(spread, 1e-9)
    normal, right = np.empty((len(rests), size, size)), np.empty((len(rests), size))
    for index, (rest, slope) in enumerate(zip(rests, slopes, strict=True)):
        weight = 1 / np.maximum(np.abs(rest) / (ROBUST * spread), 1.0)
        weight /= ALIKE_PX * spread**2
        normal[index] = (slope * weight[:, None]).T @ slope
        right[index] = slope.T @ (weight * rest)
    return normal, right, spread
