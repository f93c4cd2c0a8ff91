"""SART from coarse to fine: a good volume in a tenth of the passes.

The updates are as in ``sart``, view after view in golden-angle order. From level to level, voxels
and pixels become half as large, so that a pass takes an eighth of the next level's time. Each level
starts from the interpolated volume of the previous one, and a pass at full resolution only adds
details. Unless all rays around the object see air, the coarse grids are larger. The contents of the
last one's margin are projected and subtracted before the pass at full resolution, as in
``without_surroundings``; coarser voxels would describe them less well.

An update with a relaxation of 1 to 2 makes details in a few passes, but also noise where
several views see each voxel. The relaxation therefore falls over a level, in geometric steps, from
its first value to that value times voxels along an axis over views if there are more views, and
times ``QUIET`` over the noise of the line integrals, as a share of their range, if it is more.

Between the updates at full resolution, the total variation is lowered (``lower_variation``), in
proportion to the sum of the relaxations since the last time. Together, the two minimise the
residual plus the total variation, step by step (Bertsekas, Math. Program. 129 (2011) 163). Its
strength follows from the noise of the photons, or of air in the projections
(``strength_for``) and from the errors that voxels and materials leave in any model of the rays:
nothing of the volume has to be homogeneous. If both are unknown, the total
variation is lowered once, at the end, as strongly as the ``noise`` of the volume's homogeneous
parts requires, and not at all where there are none.

docs/algorithms.md gives the reasons for these numbers.
"""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from twinct.core.errors import InputError
from twinct.core.settings import NonNegative
from twinct.geometry import ScanGeometry, VolumeGrid
from twinct.recon.air import noise_in_air
from twinct.recon.algorithm import Algorithm, AlgorithmSettings, Problem, solve_by
from twinct.recon.checks import Checks, Mask
from twinct.recon.denoise import SHARE, lower_variation, noise
from twinct.recon.engine import Singles
from twinct.recon.further_passes import (
    ENOUGH_VIEWS,
    FOR_THICK,
    MOST_FURTHER,
    SLOW_PASSES,
    SLOW_RELAXATION,
    SMALL,
    FurtherPasses,
    suit_slow_passes,
)
from twinct.recon.levels import SMALLEST, Level, with_margin
from twinct.recon.memory import require_memory
from twinct.recon.order import spread_order
from twinct.recon.projector import LOWEST, Projector
from twinct.recon.regularisation import deviation_and_range, strength_for
from twinct.recon.resolution import interpolated
from twinct.recon.shared_keys import Stop, StopName
from twinct.recon.steps import Callback, Listener
from twinct.recon.thin_parts import are_thin
from twinct.recon.usual_margin import is_in_air, usual_margin
from twinct.recon.usual_passes import MOST_COARSE, MOST_PASSES, usual_passes, views_per_voxel
from twinct.recon.volume import Volume
from twinct.recon.working import WorkingVolume

if TYPE_CHECKING:
    from twinct.recon.further_passes import FurtherPasses

log = logging.getLogger(__name__)

LEVELS, FIRST_RELAXATION = 3, 1.5
"""Usual number of resolutions, and relaxation of the first update of each."""

COARSE_PASSES = 2
"""Usual passes of a level with voxels twice as large."""

QUIET = 0.003
"""Noise of line integrals, as a share of their range, from which more views are averaged."""

SPARSE = 0.12
"""Share of the grid below which the noise matters less: air, which cannot be negative, has none.

The relaxation falls less, and the total variation follows less from the noise."""

PER_STRENGTH = 0.15
"""Strength of the total variation, relative to that of ``strength_of_noise``, for one view."""

OF_MODEL = 0.012
"""Errors of the model of the rays, as a share of the range of line integrals; they act as noise."""

BETWEEN, MOST_STEPS = 60.0, 5
"""Sum of relaxations between two steps of the total variation; or more, for this many in a pass."""

TV_STEPS = 8
"""Dual iterations of such a step."""


class Fast(AlgorithmSettings):
    """SART from coarse to fine, with few passes at full resolution."""

    algorithm: Literal["fast"] = "fast"
    passes: int | None = Field(
        default=None,
        ge=1,
        le=1000,
        description="Passes over all views at full resolution. By default 2; 1 if there are "
        "three times as many views as voxels along an axis; 3 to 8 if there are less than 0.65 "
        "times as many, each view counted once for each pixel in a voxel's shadow. If most of the "
        "residual lies in few views, which see flat parts edge-on, further passes follow; in grids "
        "below 96 voxels along each axis, up to 3 more for thick parts or noise, and at least 5, "
        "with small updates, for thin parts.",
    )
    coarse_passes: int | None = Field(
        default=None,
        ge=1,
        le=1000,
        description="Passes over all views with voxels and pixels twice as large; each coarser "
        "level has twice as many passes. By default 2; but if the projections show only "
        "air around the object, in each level at most as many as make 6 when multiplied by the "
        "number of views per voxel along an axis.",
    )
    levels: int = Field(
        default=LEVELS,
        ge=1,
        le=6,
        description="Number of resolutions; each halves the voxels and pixels of the one before.",
    )
    first_relaxation: float = Field(
        default=FIRST_RELAXATION,
        gt=0,
        lt=2,
        description="Relaxation of the first update of a level; it decreases where there are many "
        "views for the number of voxels.",
    )
    denoising: NonNegative | None = Field(
        default=None,
        description="Strength of a total-variation denoising at the end, in voxel edges times the "
        "unit of the volume; 0 turns it off. By default, the total variation is lowered between "
        "the updates, and the strength follows from the noise of the scenario's photons or of air "
        "in the projections. If this noise is unknown, the volume is denoised at the end, and the "
        "strength follows from the noise of homogeneous parts of the volume. Without such parts, "
        "nothing is denoised, and the log says so.",
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
    stop: Stop = None


def fast(
    A: Projector,
    line_integrals: ArrayLike,
    *,
    passes: int | None = None,
    coarse_passes: int | None = None,
    levels: int = LEVELS,
    first_relaxation: float = FIRST_RELAXATION,
    denoising: float | None = None,
    margin: float | None = None,
    nonnegative: bool = True,
    mask: ArrayLike | None = None,
    photons: ArrayLike | None = None,
    stop: StopName | None = None,
    predicted_views: Sequence[int] = (),
    callback: Callback | None = None,
) -> Volume:
    """Reconstruct a volume from line integrals, mostly in larger voxels and pixels.

    Peak memory: 1.6 volumes and half of the projections, besides the projections.

    Args:
        A: the projector, with the believed geometry.
        line_integrals: p, (views, rows, columns), mm times the unit of the result.
        passes: passes at full resolution, at least 1; by default 2, 1 with many views, up to 8 with
            few, and then further ones; thin parts may start again (see ``further_passes``).
        coarse_passes: passes at half the resolution, at least 1; twice as many at each coarser
            level; by default 2; with air around the object, fewer where a level has
            many views per voxel.
        levels: at least 1; fewer if the coarsest would have less than 8 voxels or pixels.
        first_relaxation: relaxation of the first update of a level, between 0 and 2, both excluded.
        denoising: strength of the total variation at the end in voxel edges times the unit of the
            result; 0 for none; by default it is lowered between the updates, if the noise can be
            known.
        margin: margin of the coarse grids on each side, as a share of the grid's size along each
            axis; by default ``usual_margin``.
        nonnegative: clip at zero after every update.
        mask: as in ``sart``.
        photons: photons of a pixel in the free beam, one number or one for each view, (views,);
            without them, air in the projections shows the noise.
        stop: ``auto``: make as many passes as by default, but at most ``passes``.
        predicted_views: numbers of views to predict.
        callback: called after each update; see ``Step``. Volumes of coarse levels are coarse. True
            stops.

    Returns:
        The volume. Its extras hold, with ``stop``, the number of ``passes`` at full resolution;
        without a given strength, ``denoising``: its ``strength`` in a
        pass with a relaxation of 1, in the unit of ``denoising``, and ``from``, the source of the
        noise: ``photons``, ``air``, ``volume`` or None; with ``predicted_views``, ``predicted``:
        their line integrals through the volume and what lies around it,
        (len(predicted_views), rows, columns).

    Raises:
        InputError: as in ``sart``; or the grid with its margin reaches behind a source.
    """
    checks = Checks(A.range_shape)
    p, pixels = checks.projections(line_integrals, mask)
    known = checks.photons(photons)
    usual = usual_passes(A)
    limit = math.inf if passes is None else checks.count("passes", passes)
    checks.stop(stop)
    usual_coarse = coarse_passes is None
    coarse_passes = checks.count(
        "coarse_passes", COARSE_PASSES if coarse_passes is None else coarse_passes
    )
    levels = checks.count("levels", levels)
    relaxation = checks.relaxation(first_relaxation)
    if margin is not None:
        margin = checks.not_negative("margin", margin)
    if denoising is not None:
        denoising = checks.not_negative("denoising", denoising)
    checks.done()
    as_usual = usual_coarse and (levels, relaxation, margin or 0) == (LEVELS, FIRST_RELAXATION, 0)
    require_memory(FAST, A)
    in_air = False
    if margin is None:
        margin = usual_margin(A, p, pixels, _factors(A.domain_shape, A.range_shape[1:], levels)[0])
        in_air = margin == 0
        log.info("margin of the coarse grids: %g of the grid's size on each side", margin)
    floor = 0.0 if nonnegative else LOWEST
    most = MOST_COARSE / views_per_voxel(A) if usual_coarse and in_air else math.inf
    coarse = coarse_passes, most
    chosen = passes is None or stop is not None
    passes = int(min(usual, limit)) if chosen else int(limit)
    further = min(MOST_FURTHER, limit - passes) if chosen else 0
    steps = _Steps(passes, *coarse, levels, relaxation, margin, floor, further)
    steps = _for_noise(A, p, pixels, steps, known, lowers=denoising is None)
    if as_usual and further == MOST_FURTHER and steps.strength:
        steps = replace(steps, may_repeat=suit_slow_passes(A) and is_in_air(A, p, pixels))
    steps, level, x, whole = _from_coarse_to_fine(A, p, pixels, steps, callback)
    extras: dict[str, Any] = {} if stop is None else {"passes": steps.passes}
    if len(predicted_views) and whole:
        extras = extras | {"predicted": level.line_integrals(x, predicted_views)}
    x = level.whole(x) if whole else interpolated(level.whole(x), level.A.grid, A.grid)
    del level
    if not whole:
        return Volume(x, A.grid, extras)
    voxel = float(A.grid.voxel.mean())
    if denoising is None and steps.source:
        strength = steps.strength * len(A) / voxel
        return Volume(x, A.grid, extras | {"denoising": _of(strength, steps.source)})
    if denoising is None:
        denoising, source = _of_volume(x)
        extras = extras | {"denoising": _of(denoising, source)}
    if denoising:
        lower_variation(x, A.grid, A.kernels, denoising * voxel, floor)
    return Volume(x, A.grid, extras)


def _filled(x: Singles) -> float:
    """Return the share of the voxels above a tenth of the densest ones, not 0.

    An eighth of the voxels shows it: ``x`` is interpolated from voxels twice as large.
    """
    some = x[::2, ::2, ::2]
    return max(float(np.mean(some > 0.1 * np.percentile(some, 99.9))), 1e-3)


def _of(strength: float, source: str | None) -> dict[str, float | str | None]:
    return {"strength": strength, "from": source}


@dataclass(frozen=True)
class _Steps:
    """Checked settings of ``fast``, and what follows from the noise.

    Attributes:
        passes: number of passes at full resolution.
        coarse_passes: number of passes with voxels twice as large.
        most_coarse: most passes of coarse levels, times the factor of their voxels.
        further: most passes that may follow (``FurtherPasses``).
        may_repeat: whether thin parts are reconstructed again, slowly.
        slow: whether this is being done.
        noise: deviation of the line integrals; 0 if it is unknown.
        most: range of the line integrals.
        strength: of the total variation for one view, mm times the unit of the volume.
        source: source of the noise that it follows from; None: nothing is lowered in between.
        filled: share of the grid that is filled, relative to ``SPARSE``, at most 1.
    """

    passes: int
    coarse_passes: int
    most_coarse: float
    levels: int
    relaxation: float
    margin: float
    floor: float
    further: float
    noise: float = 0.0
    most: float = 0.0
    strength: float = 0.0
    source: str | None = None
    filled: float = 1.0
    may_repeat: bool = False
    slow: bool = False

    def number(self, factor: int) -> int:
        """Return the number of passes of a level."""
        if factor == 1:
            return self.passes
        most = max(1.0, self.most_coarse / factor)
        return round(min(self.coarse_passes * factor / 2, most))

    def filling(self, start: Singles) -> _Steps:
        """Return the steps at full resolution, from the volume before."""
        filled, model = min(1.0, _filled(start) / SPARSE), OF_MODEL * self.most
        all_noise = math.hypot(self.noise, model)
        less = math.hypot(filled * self.noise, model) / all_noise if all_noise else 1.0
        return replace(self, filled=filled, strength=less * self.strength)

    def further_passes(self, A: Projector) -> FurtherPasses | None:
        """Return the monitor that asks for further passes at full resolution, if any may follow."""
        few = views_per_voxel(A) < ENOUGH_VIEWS
        small = max(A.domain_shape) < SMALL and self.passes + FOR_THICK <= MOST_PASSES
        if not self.further or not (few or small):
            return None
        kinds = {"few": few, "small": small, "fills": self.filled == 1.0, "slow": self.slow}
        return FurtherPasses(len(A), self.noise, **kinds, most=self.further)

    def slowly(self) -> _Steps:
        """Return the steps with which thin parts are reconstructed again."""
        slow = {"passes": SLOW_PASSES, "relaxation": SLOW_RELAXATION, "slow": True}
        return replace(self, **slow, margin=0.0, may_repeat=False)

    def shares(self, A: Projector, factor: int) -> NDArray[np.float64]:
        """Return the relaxation of each update of a level."""
        updates = self.number(factor) * len(A)
        if self.slow:
            return np.full(updates, self.relaxation)
        last = self.relaxation * min(1.0, float(np.mean(A.domain_shape)) / len(A))
        if factor == 1 and self.noise > 0:
            quiet = QUIET * self.most / self.noise
            last *= min(1.0, quiet / self.filled**2)
        return np.geomspace(self.relaxation, last, updates)


def _for_noise(
    A: Projector,
    p: NDArray[Any],
    pixels: Mask | None,
    steps: _Steps,
    photons: NDArray[np.float64] | None,
    *,
    lowers: bool,
) -> _Steps:
    """Return the steps for the noise of the line integrals, if it is known."""
    if (seen := noise_in_air(p, pixels, photons)) is None:
        return steps
    deviation, most = deviation_and_range(p, seen, pixels)
    steps = replace(steps, noise=deviation, most=most)
    if not lowers:
        return steps
    strength = PER_STRENGTH * strength_for(A, math.hypot(deviation, OF_MODEL * most))
    log.info(
        "noise of %.3g of line integrals, of their range of %.3g (%s)", deviation, most, seen.source
    )
    return replace(steps, strength=strength, source=seen.source)


def _from_coarse_to_fine(
    A: Projector,
    p: NDArray[Any],
    pixels: Mask | None,
    steps: _Steps,
    callback: Callback | None = None,
) -> tuple[_Steps, Level, Singles, bool]:
    """Return the last level's steps, the level, its volume, and False if the callback stopped it.

    The volume is without the rest that the level leaves as it is.
    """
    factors = deque(_factors(A.domain_shape, A.range_shape[1:], steps.levels))
    listener = Listener(callback, len(A) * sum(map(steps.number, factors)))
    done, before = 0, None
    while factors:
        factor = factors.popleft()
        level = Level.of(A, p, pixels, factor, steps.margin, before)
        before = None  # frees the coarser level, as does each ``del``
        work, since = WorkingVolume(level.A.kernels, level.start()), 0.0
        own = steps.filling(work.array) if factor == 1 else steps
        shares, order = own.shares(level.A, factor), spread_order(len(A))
        further = own.further_passes(A) if factor == 1 else None
        between = max(BETWEEN, float(shares[: len(A)].sum()) / MOST_STEPS)
        pending = deque(zip(shares, np.resize(order, len(shares)), strict=True))
        wanted = listener.wanted or further is not None
        while pending:
            share, view = pending.popleft()
            square, rays = level.update(work, int(view), float(share), steps.floor, wanted)
            since += float(share)
            ended = factor == 1 and len(pending) % len(A) == 0
            if own.strength and factor == 1 and (ended or since > between):
                work, since = _lowered(level.A, work, since * own.strength, steps.floor), 0.0
            if further:
                further.add(int(view), square, rays)
                if not pending and further.another_pass(work.array):
                    pending.extend((shares[-1], one) for one in order)
                    listener.updates += len(order)
            sparse = factor == 1 and steps.may_repeat and own.filled < 1
            if not pending and sparse and are_thin(work.array):
                log.info("the object consists of thin parts: again, with small updates")
                steps = steps.slowly()
                factors.append(1)
                listener.updates += steps.passes * len(A)
            if listener(0, done, square, rays, work):
                return own, level, work.array, False
            done += 1
        if not factors:
            made = own.passes + (further.passes if further else 0)
            return replace(own, passes=made), level, work.array, True
        before = None if factor == 1 else (level, level.whole(work.array))
        del level, work  # frees the card
    raise AssertionError("the last factor is 1")


def _lowered(A: Projector, work: WorkingVolume, strength: float, floor: float) -> WorkingVolume:
    """Return the volume with less total variation."""
    x = work.array
    del work
    lower_variation(x, A.grid, A.kernels, strength, floor, steps=TV_STEPS)
    A.blocks.clear(x)
    return WorkingVolume(A.kernels, x)


def _of_volume(x: Singles) -> tuple[float, str | None]:
    """Return the strength of a denoising at the end, and the source of the noise, or None."""
    deviation = noise(x)
    if deviation is None:
        log.warning(
            "the volume was not denoised: it has no homogeneous parts, the number of photons is "
            "unknown and the projections show no air; state the strength "
            "(reconstruction.denoising)"
        )
        return 0.0, None
    log.info("noise of %.3g in homogeneous parts of the volume", deviation)
    return SHARE * deviation, "volume"


def _factors(voxels: tuple[int, ...], pixels: tuple[int, ...], levels: int) -> list[int]:
    """Return the factors by which voxels and pixels are larger, level by level."""
    least = min(*voxels, *pixels)
    factors = [2**n for n in reversed(range(levels))]
    return [factor for factor in factors if factor == 1 or least // factor >= SMALLEST]


def _check(settings: Fast, views: ScanGeometry, grid: VolumeGrid) -> None:
    """Check the coarsest grid."""
    factor = _factors(grid.shape, views.panel.shape, settings.levels)[0]
    if factor == 1:
        return
    try:
        with_margin(views, grid, factor, settings.margin or 0.0)
    except InputError as error:
        raise InputError(f"reconstruction.margin: {one}" for one in error.problems) from None


def _solve(problem: Problem, settings: Fast) -> Volume:
    margin = settings.margin
    if margin is None and problem.alone:
        margin = 0.0
    return solve_by(fast, problem, settings, nonnegative=not settings.allow_negative, margin=margin)


FAST = Algorithm(
    Fast,
    _solve,
    volumes=1.6,
    projections=0.5,
    check=_check,
    updates=lambda own, views: (
        # About: the usual number of passes depends on the grid and on the residual.
        views
        * (
            (min(own.passes or 4, 4) if own.stop else own.passes or 4)
            + (own.coarse_passes or COARSE_PASSES) * (2 ** (own.levels - 1) - 1)
        )
    ),
)
