"""Penalised least squares from coarse to fine, with a strength that left-out views find.

The volume minimises, over x >= 0, half the weighted squared residual of the line integrals plus a
strength times the total variation (``ordered_subsets``). Weights are one over the variance of noise
and of the model's error (``ray_weights``). Without a stated strength, a trial finds it
(``strength``).

It starts from SART, from coarse to fine: from level to level, voxels and pixels become half as
large, so that a pass takes an eighth of the next level's time. Each level starts from the
interpolated volume of the previous one. Unless all rays around the object see air, the coarse grids
are larger. The contents of the last one's margin are projected and subtracted before the passes at
full resolution, as in ``without_surroundings``; coarser voxels would describe them less well.

The updates at full resolution end when a pass changes the volume by less than a tolerance.
"""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from twinct.core.errors import InputError
from twinct.core.settings import NonNegative
from twinct.geometry import ScanGeometry, VolumeGrid
from twinct.recon.air import KnownNoise, noise_in_air
from twinct.recon.algorithm import Algorithm, AlgorithmSettings, Problem, solve_by
from twinct.recon.checks import Mask
from twinct.recon.engine import Singles
from twinct.recon.levels import SMALLEST, Level, with_margin
from twinct.recon.order import spread_order
from twinct.recon.ordered_subsets import Minimiser, subsets_for
from twinct.recon.prepared import Prepared
from twinct.recon.projector import LOWEST, Projector
from twinct.recon.ray_weights import RayWeights, error_of_model
from twinct.recon.resolution import interpolated
from twinct.recon.shared_keys import Passes, Tolerance
from twinct.recon.steps import Callback, Listener
from twinct.recon.strength import Forces, tried
from twinct.recon.usual_margin import usual_margin
from twinct.recon.volume import Volume
from twinct.recon.working import WorkingVolume

log = logging.getLogger(__name__)

LEVELS, RELAXATION = 3, 1.5
"""Number of resolutions, and relaxation of the first update of SART at each. With more views than
voxels along an axis it falls, over a level, to this value times voxels over views."""

COARSE_PASSES = 2
"""Passes of SART with voxels twice as large; twice as many with the next larger ones."""

PASSES, FEWEST_PASSES, TOLERANCE = 12, 2, 0.02
"""Most passes and fewest at full resolution, and the change of the volume in the last one."""


class Penalised(AlgorithmSettings):
    """Keys of least squares plus total variation, from coarse to fine.

    The algorithms that share them differ in their budget: the defaults of the first two.
    """

    passes: Passes = PASSES
    tolerance: Tolerance = TOLERANCE
    levels: int = Field(
        default=LEVELS,
        ge=1,
        le=6,
        description="Number of resolutions; each halves the voxels and pixels of the one before.",
    )
    strength: NonNegative | None = Field(
        default=None,
        description="Strength of the total variation: borders of this height "
        "(in the unit of the volume) around parts of this radius (in mm) vanish where the product "
        "is below about three times it. By default, views that are left out of a trial at half the "
        "resolution find it.",
    )
    margin: float | None = Field(
        default=None,
        ge=0,
        le=2,
        description="Extra width of the coarse grids on each side, as a share of the grid's size; "
        "the contribution of this margin is removed before the passes at full resolution. By "
        "default 0 where the surroundings are removed, or where the rays that miss the grid and "
        "those at the panel's border see air; else 0.1 to 0.3, as a short trial requires.",
    )
    allow_negative: bool = Field(default=False, description="Whether voxels may fall below 0.")


class Fast(Penalised):
    """Least squares plus total variation, from coarse to fine; left-out views find its strength."""

    algorithm: Literal["fast"] = "fast"


def fast(
    A: Projector,
    line_integrals: ArrayLike,
    *,
    passes: int = PASSES,
    tolerance: float = TOLERANCE,
    levels: int = LEVELS,
    strength: float | None = None,
    margin: float | None = None,
    nonnegative: bool = True,
    mask: ArrayLike | None = None,
    photons: ArrayLike | None = None,
    predicted_views: Sequence[int] = (),
    callback: Callback | None = None,
) -> Volume:
    """Reconstruct a volume from line integrals, first in larger voxels and pixels.

    Peak memory: 4 volumes and half of the projections, besides the projections.

    Args:
        A: the projector, with the believed geometry.
        line_integrals: p, (views, rows, columns), mm times the unit of the result.
        passes: most passes at full resolution, at least 1, after one of SART.
        tolerance: they end when one changes the volume by less than this share.
        levels: at least 1; fewer if the coarsest would have less than 8 voxels or pixels.
        strength: of the total variation, mm times the unit of the result (``ordered_subsets``); by
            default, left-out views find it.
        margin: margin of the coarse grids on each side, as a share of the grid's size along each
            axis; by default ``usual_margin``.
        nonnegative: x >= 0.
        mask: as in ``sart``.
        photons: photons of a pixel in the free beam, one number or one for each view, (views,);
            without them, air in the projections shows the noise.
        predicted_views: numbers of views to predict.
        callback: called after each update; see ``Step``. Volumes of coarse levels are coarse. True
            stops.

    Returns:
        The volume. Its extras hold ``regularisation``: its ``strength``, ``from``, the source of
        the noise: ``photons``, ``air`` or None, and ``factor``, what the trial found, or None;
        ``passes`` at full resolution, and ``change`` of the volume in the last one; with
        ``predicted_views``, ``predicted``: their line integrals through the volume and what lies
        around it, (len(predicted_views), rows, columns).

    Raises:
        InputError: as in ``sart``; or the grid with its margin reaches behind a source.
    """
    checks = Prepared(FAST, A, line_integrals, mask)
    p, pixels, known = checks.p, checks.pixels, checks.photons(photons)
    passes = checks.count("passes", passes)
    levels = checks.count("levels", levels)
    if margin is not None:
        margin = checks.not_negative("margin", margin)
    if strength is not None:
        strength = checks.not_negative("strength", strength)
    checks.done()
    factors = _factors(A.domain_shape, A.range_shape[1:], levels)
    if margin is None:
        margin = usual_margin(A, p, pixels, factors[0])
        log.info("margin of the coarse grids: %g of the grid's size on each side", margin)
    floor = 0.0 if nonnegative else LOWEST
    noise = noise_in_air(p, pixels, known)
    scan = _Scan(A, p, pixels, noise, margin, floor, passes, tolerance, strength)
    level, x, extras = scan.solved(deque(factors), callback)
    whole = level.A.grid.shape == A.grid.shape
    if len(predicted_views) and whole:
        extras = extras | {"predicted": level.line_integrals(x, predicted_views)}
    x = level.whole(x) if whole else interpolated(level.whole(x), level.A.grid, A.grid)
    return Volume(x, A.grid, extras)


@dataclass(frozen=True, eq=False)
class _Scan:
    """Checked arguments of ``fast``."""

    A: Projector
    p: NDArray[Any]
    pixels: Mask | None
    noise: KnownNoise | None
    margin: float
    floor: float
    passes: int
    tolerance: float
    strength: float | None

    def solved(
        self, factors: deque[int], callback: Callback | None
    ) -> tuple[Level, Singles, dict[str, Any]]:
        """Return the last level, its volume without the rest, and the extras."""
        updates = sum(_sart_passes(factor) for factor in factors) * len(self.A)
        most = self.passes * subsets_for(len(self.A))
        listener, done = Listener(callback, updates + most), 0
        before, found = None, None
        while True:
            factor = factors.popleft()
            level = Level.of(self.A, self.p, self.pixels, factor, self.margin, before)
            before = None  # frees the coarser level, as does each ``del``
            work = WorkingVolume(level.A.kernels, level.start())
            shares = _shares(level.A, factor)
            order = np.resize(spread_order(len(self.A)), len(shares))
            for share, view in zip(shares, order, strict=True):
                square, rays = level.update(
                    work, int(view), float(share), self.floor, listener.wanted
                )
                if listener(0, done, square, rays, work):
                    return level, work.array, {}
                done += 1
            x = work.array
            del work  # frees the card
            if factor == 2 and self.strength is None:
                trial = tried(level, x, self._weights(level, x, factor), self.floor)
                found = trial and trial.factor
            if not factors:
                return self._minimised(level, x, found, listener, done)
            before = level, level.whole(x)

    def _weights(self, level: Level, x: Singles, factor: int) -> RayWeights:
        """Return the weights of a level's rays: means over larger pixels have less noise."""
        noise = self.noise
        variance = np.zeros(len(self.A)) if noise is None else noise.in_air**2 / factor**2
        return RayWeights(variance, error_of_model(level.A, x))

    def _minimised(
        self, level: Level, x: Singles, found: float | None, listener: Listener, done: int
    ) -> tuple[Level, Singles, dict[str, Any]]:
        """Return the level, the minimised volume, and the extras; ``found`` is that of a trial."""
        minimiser = Minimiser(level, x, self._weights(level, x, 1), self.floor)
        del x
        if self.strength is None:
            minimiser.strength = Forces.of(minimiser).strength(1.0 if found is None else found)
        else:
            minimiser.strength = self.strength
        count = done

        def notify(square: float, rays: int, x: Singles) -> bool:
            nonlocal count
            count += 1
            return listener(0, count - 1, square, rays, x)

        passes, stopped = 0, False
        least = min(FEWEST_PASSES, self.passes)
        while not stopped and passes < self.passes:
            if passes >= least and minimiser.change < self.tolerance:
                break
            stopped = minimiser.one_pass(notify if listener.wanted else None)
            passes += 1
        change = minimiser.change
        extras: dict[str, Any] = {"passes": passes}
        if math.isfinite(change):
            extras["change"] = change
            short = "" if change < self.tolerance else ", so it is not at its minimum yet"
            log.info("pass %d changed the volume by %.2g %%%s", passes, 100 * change, short)
        if self.strength is None:
            source = None if self.noise is None else self.noise.source
            known = {"from": source, "factor": found}
            extras["regularisation"] = {"strength": minimiser.strength, **known}
        return level, minimiser.x, extras


def _sart_passes(factor: int) -> int:
    """Return the number of passes of SART of a level."""
    return 1 if factor == 1 else COARSE_PASSES * factor // 2


def _shares(A: Projector, factor: int) -> NDArray[np.float64]:
    """Return the relaxation of each update of SART of a level."""
    last = RELAXATION * min(1.0, float(np.mean(A.domain_shape)) / len(A))
    return np.geomspace(RELAXATION, last, _sart_passes(factor) * len(A))


def _factors(voxels: tuple[int, ...], pixels: tuple[int, ...], levels: int) -> list[int]:
    """Return the factors by which voxels and pixels are larger, level by level."""
    least = min(*voxels, *pixels)
    factors = [2**n for n in reversed(range(levels))]
    return [factor for factor in factors if factor == 1 or least // factor >= SMALLEST]


def _check(settings: Penalised, views: ScanGeometry, grid: VolumeGrid) -> None:
    """Check the coarsest grid."""
    factor = _factors(grid.shape, views.panel.shape, settings.levels)[0]
    if factor == 1:
        return
    try:
        with_margin(views, grid, factor, settings.margin or 0.0)
    except InputError as error:
        raise InputError(f"reconstruction.margin: {one}" for one in error.problems) from None


def _solve(problem: Problem, settings: Penalised) -> Volume:
    margin = settings.margin
    if margin is None and problem.alone:
        margin = 0.0
    return solve_by(fast, problem, settings, nonnegative=not settings.allow_negative, margin=margin)


FAST: Algorithm[Penalised] = Algorithm(
    Fast,
    _solve,
    volumes=4,
    projections=0.5,
    check=_check,
    # About: the number of passes at full resolution depends on the volume.
    updates=lambda own, views: (
        views * sum(_sart_passes(2**n) for n in range(own.levels)) + 4 * subsets_for(views)
    ),
)
