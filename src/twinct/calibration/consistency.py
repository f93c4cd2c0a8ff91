"""Geometry from the projections of the specimen alone: each view is moved until it agrees with all.

In alternation a volume is reconstructed from what is known of the geometry, and each view's source
and panel, or the patient between them, are moved so that the volume's line integrals become those
that were measured (registration of projections to a volume, as in Ouadah et al., Phys. Med. Biol.
61 (2016) 2613, the volume being the scan's own). A rigid motion of everything and its scale change
no projection: these seven cannot be seen, and the prior, errors about zero, keeps them where they
were believed. (Of a patient who moves, six: source and panel are as far apart as believed.)

The volume has to fit the projections as closely as it can: only at the best one do poses change
the least residual as they change that of the volume held fixed (envelope theorem; Golub and
Pereyra, SIAM J. Numer. Anal. 10 (1973) 413). What a few passes of SART leave pulls errors that are
alike over many views away from the truth, the more the more rounds there are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinct.calibration.freedom import Freedom, PosePrior, What
from twinct.errors import InputError
from twinct.geometry import Floats, ScanGeometry, VolumeGrid
from twinct.progress import SILENT, Progress
from twinct.recon import Projector, fista_tv, sart
from twinct.recon.resolution import binned, interpolated
from twinct.recon.surroundings import coarse_grid
from twinct.volume import Volume

ROBUST = 1.5
"""Residuals above so many standard deviations pull with that of one there (Huber)."""

ALIKE_PX = 12.0
"""Residuals of neighbouring pixels are alike: so many count as one."""

CLOSENESS = 1e-3
"""Regularisation over the volume's attenuation (the mean, weighted by itself): next to none."""

MOMENTUM = 0.5
"""Share of a round's change that the next makes again: a volume that fits gives way slowly."""

SMALLEST = 16
"""Pixels and voxels along each axis that a round needs."""


@dataclass(frozen=True)
class Round:
    """One reconstruction and the step after it.

    Attributes:
        factor: pixels and voxels are so many times as large.
        passes: over all views; each round goes on from the volume before.
    """

    factor: int
    passes: int = 4


ROUNDS = (*[Round(4)] * 4, *[Round(2)] * 4)

FROM_START = ROUNDS[4:]
"""A start by planes is about as near as coarse rounds come, or nearer: these would lead away."""

FEW_PIXELS = (Round(1),) * 4
"""Where none of the rounds asked for leaves enough."""


@dataclass(frozen=True, eq=False)
class SelfCalibration:
    """What a scan says of its own geometry.

    Attributes:
        geometry: of all views.
        change: against what was believed: of arms as ``resection.PARAMETERS``, (views, 9); of a
            patient what source and panel moved by in the patient's frame, as a twist (v, w) about
            the middle of the grid, world axes, (views, 6), mm and rad.
        residuals: spread of measured minus projected line integrals, before each round's step.
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
        believed: about where source and panel were.
        grid: that holds the specimen, at full resolution.
        prior: what is known of the errors.
        what: may have moved; of a patient who does, the geometry found is relative to the patient.
        rounds: from coarse to fine, ``ROUNDS`` unless given, with a start ``FROM_START``; those
            that leave hardly any pixels or voxels are left out; where none is left, four at full
            resolution.
        mask: True where a pixel counts, (rows, columns) or (views, rows, columns).
        start: changes to go on from, as in ``SelfCalibration.change`` and such as
            ``epipolar_consistent`` finds; none unless given. The prior stays one of errors about
            what was believed.
        progress: hears of each round.

    Raises:
        InputError: ``start`` is of other views or numbers.
    """
    free = Freedom(what, grid.world_from_grid.position)
    size = len(free.steps)
    change = np.zeros((len(believed), size)) if start is None else start
    if change.shape != (len(believed), size):
        raise InputError(f"start has shape {change.shape}: {(len(believed), size)} needed")
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
            coarse = coarse_grid(grid, 0.0, one.factor * grid.voxel)
            geometry = free.all(believed, change)
            A = Projector(geometry.binned(one.factor, one.factor), coarse)
            volume = _fitted(A, p, counts, one.passes, volume)
            normal, right, spread = _normal_equations(
                volume.array, p, counts, believed, free, change, coarse, one.factor
            )
            residuals.append(spread)
            hessian = precision.copy()
            for view in range(len(believed)):
                own = slice(size * view, size * view + size)
                hessian[own, own] += normal[view]
            pull = right.ravel() - precision @ change.ravel()
            step_on = np.linalg.solve(hessian, pull).reshape(change.shape)
            before, change = change, change + step_on + MOMENTUM * (change - before)
            step()
    return SelfCalibration(free.all(believed, change), change, tuple(residuals))


def _fitted(
    A: Projector,
    p: NDArray[np.float32],
    counts: NDArray[np.bool_] | None,
    passes: int,
    before: Volume | None,
) -> Volume:
    """The volume that fits best, sought from the one before; from a pass of SART if none was."""
    if before is None:
        start = sart(A, p, iterations=1, relaxation=0.3, nonnegative=True, mask=counts).array
    else:
        start = before.array
        if before.grid.shape != A.grid.shape:
            start = interpolated(start, before.grid, A.grid)
    mass = float(start.sum(dtype=np.float64))
    mean = float(np.square(start, dtype=np.float64).sum()) / mass if mass > 0 else 0.0
    return fista_tv(A, p, iterations=passes, regularisation=CLOSENESS * mean, x0=start, mask=counts)


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
    """Of all views, (views, n, n) and (views, n), and the residuals' spread."""
    steps = free.steps
    rests: list[Floats] = []
    slopes: list[Floats] = []
    for index, view in enumerate(believed):
        about = [change[index]]
        for one in np.diag(steps):
            about += [change[index] + one, change[index] - one]
        tried = ScanGeometry.joined([free.view(view, one) for one in about])
        A = Projector(tried.binned(factor, factor), grid)
        images = A(x)
        seen = (A[0].chords()[0] > 0).ravel()
        if counts is not None:
            seen &= (counts if counts.ndim == 2 else counts[index]).ravel()
        flat = images.reshape(len(images), -1)[:, seen].astype(np.float64)
        rests.append(p[index].ravel()[seen] - flat[0])
        slopes.append((flat[1::2] - flat[2::2]).T / (2 * steps))
    pooled = np.concatenate(rests)
    spread = 1.4826 * float(np.median(np.abs(pooled)))
    spread = max(spread, 1e-9)
    size = len(steps)
    normal, right = np.empty((len(rests), size, size)), np.empty((len(rests), size))
    for index, (rest, slope) in enumerate(zip(rests, slopes, strict=True)):
        weight = 1 / np.maximum(np.abs(rest) / (ROBUST * spread), 1.0)
        weight /= ALIKE_PX * spread**2
        normal[index] = (slope * weight[:, None]).T @ slope
        right[index] = slope.T @ (weight * rest)
    return normal, right, spread
