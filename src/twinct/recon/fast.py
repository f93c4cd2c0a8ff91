"""SART from coarse to fine: a good volume in a tenth of the passes.

The updates are as in ``sart``, view after view in golden-angle order. From level to level, voxels
and pixels become half as large, so that a pass takes an eighth of the next level's time. Each level
starts from the interpolated volume of the previous one, and a pass at full resolution only adds
details. The coarse grids are larger. The contents of the last one's margin are projected and
subtracted before the pass at full resolution, as in ``without_surroundings``; coarser voxels would
describe them less well.

An update with a relaxation of 1 to 2 makes details in one pass, but also noise where several views
see each voxel. If views outnumber the voxels along an axis, the relaxation therefore falls over a
level, in geometric steps, from its first value to that value times voxels along an axis over views,
or with much noise times the square of that. The remaining noise is reduced by total variation
(``lower_variation``), as strong as the ``noise`` of the volume's homogeneous parts requires, but no
stronger than the noise of the photons, or of air in the projections, allows: what exceeds that
after the same steps is texture. Where there are no such parts, as in thin ones, the noise of the
photons or of air counts alone, and where it is unknown, too, nothing is denoised.

docs/reconstruction.md gives the reasons for these numbers.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from twinct.core.errors import InputError
from twinct.core.settings import NonNegative
from twinct.geometry import ScanGeometry, VolumeGrid
from twinct.recon.algorithm import Algorithm, AlgorithmSettings, Problem, solve_by
from twinct.recon.checks import Checks, Mask, mask_of, masked_image
from twinct.recon.denoise import (
    MOST_OF_PHOTONS,
    SHARE,
    SHARE_IN_THIN_PARTS,
    lower_variation,
    noise,
)
from twinct.recon.engine import Singles
from twinct.recon.memory import require_memory
from twinct.recon.order import spread_order
from twinct.recon.projector import LOWEST, Projector, check_grid
from twinct.recon.resolution import binned, interpolated, resampled
from twinct.recon.shared_keys import Stop
from twinct.recon.steps import Callback, Listener, residual_of
from twinct.recon.stopping import BestPass, StopName
from twinct.recon.surroundings import coarse_grid
from twinct.recon.volume import Volume
from twinct.recon.working import WorkingVolume

if TYPE_CHECKING:
    from twinct.recon.air import KnownNoise

log = logging.getLogger(__name__)

SMALL, FEWEST_VIEWS = 48, 24
"""Voxels along an axis, and views, of the smallest scan that stands for a larger one."""

QUIET = 0.01
"""Noise of line integrals, as a share of their range, from which more views are averaged."""

MOST_VIEWS = 16
"""Number of views from which the range is taken."""

SMALLEST = 8
"""Smallest number of voxels and pixels along an axis of a coarser level."""


class Fast(AlgorithmSettings):
    """SART from coarse to fine, with one pass at full resolution."""

    algorithm: Literal["fast"] = "fast"
    passes: int = Field(
        default=1, ge=1, le=1000, description="Passes over all views at full resolution."
    )
    coarse_passes: int = Field(
        default=3,
        ge=1,
        le=1000,
        description="Passes over all views with voxels and pixels twice as large; each coarser "
        "level has twice as many passes.",
    )
    levels: int = Field(
        default=3,
        ge=1,
        le=6,
        description="Number of resolutions; each halves the voxels and pixels of the one before.",
    )
    first_relaxation: float = Field(
        default=1.5,
        gt=0,
        lt=2,
        description="Relaxation of the first update of a level; it decreases where there are many "
        "views for the number of voxels.",
    )
    denoising: NonNegative | None = Field(
        default=None,
        description="Strength of the final total-variation denoising, in voxel edges times the "
        "unit of the volume; 0 turns it off. By default it follows from the noise of homogeneous "
        "parts of the volume, bounded by that of the scenario's photons or of air in the "
        "projections, which counts alone if there are no such parts; if both are unknown, nothing "
        "is denoised, and the log says so.",
    )
    margin: float = Field(
        default=0.2,
        ge=0,
        le=2,
        description="Extra width of the coarse grids on each side, as a share of the grid's size; "
        "the contribution of this margin is removed before the pass at full resolution.",
    )
    allow_negative: bool = Field(default=False, description="Whether voxels may fall below 0.")
    stop: Stop = None


def fast(
    A: Projector,
    line_integrals: ArrayLike,
    *,
    passes: int = 1,
    coarse_passes: int = 3,
    levels: int = 3,
    first_relaxation: float = 1.5,
    denoising: float | None = None,
    margin: float = 0.2,
    nonnegative: bool = True,
    mask: ArrayLike | None = None,
    photons: ArrayLike | None = None,
    stop: StopName | None = None,
    callback: Callback | None = None,
) -> Volume:
    """Reconstruct a volume from line integrals, mostly in larger voxels and pixels.

    Peak memory: 2.2 volumes and half of the projections, besides the projections.

    Args:
        A: the projector, with the believed geometry.
        line_integrals: p, (views, rows, columns), mm times the unit of the result.
        passes: passes at full resolution, at least 1.
        coarse_passes: passes at half the resolution, at least 1; twice as many at each coarser
            level.
        levels: at least 1; fewer if the coarsest would have less than 8 voxels or pixels.
        first_relaxation: relaxation of the first update of a level, between 0 and 2, both excluded.
        denoising: strength of the total variation in voxel edges times the unit of the result;
            0 for none; by default estimated from the noise, if it can be known.
        margin: margin of the coarse grids on each side, as a share of the grid's size along each
            axis.
        nonnegative: clip at zero after every update.
        mask: as in ``sart``.
        photons: photons of a pixel in the free beam, one number or one for each view, (views,);
            without them, air in the projections shows the noise.
        stop: ``auto``: end with the last pass at full resolution that improves the volume; see
            ``BestPass``. As any pass may be the last, the relaxation falls anew in each of them.
        callback: called after each update; see ``Step``. Volumes of coarse levels are coarse. True
            stops.

    Returns:
        The volume. Its extras hold, with ``stop``, the number of ``passes`` at full resolution;
        without a given strength, ``denoising``: its ``strength``, and ``from``, the source of the
        noise: ``volume``, ``photons``, ``air`` or None.

    Raises:
        InputError: as in ``sart``; or the grid with its margin reaches behind a source.
    """
    from twinct.recon.air import known_noise  # only here: scenarios need the settings alone

    checks = Checks(A.range_shape)
    p, pixels = checks.projections(line_integrals, mask)
    known = checks.photons(photons)
    passes = checks.count("passes", passes)
    coarse_passes = checks.count("coarse_passes", coarse_passes)
    levels = checks.count("levels", levels)
    relaxation = checks.relaxation(first_relaxation)
    margin = checks.not_negative("margin", margin)
    if denoising is not None:
        denoising = checks.not_negative("denoising", denoising)
    best = BestPass.checked(checks, stop)
    checks.done()
    require_memory(FAST, A)
    floor = 0.0 if nonnegative else LOWEST
    seen = known_noise(p, pixels, known)
    power = _power(p, pixels, seen)
    steps = _Steps(passes, coarse_passes, levels, relaxation, margin, floor, power)
    x, whole = _from_coarse_to_fine(A, p, pixels, steps, best, callback)
    extras: dict[str, Any] = best.extras
    if not whole:
        return Volume(x, A.grid, extras)
    if denoising is None:
        steps = replace(steps, passes=extras.get("passes", passes))
        denoising, source = _strength(A, p, pixels, x, seen, steps)
        extras = extras | {"denoising": {"strength": denoising, "from": source}}
    del best
    if denoising:
        lower_variation(x, A.grid, A.kernels, denoising * float(A.grid.voxel.mean()), floor)
    return Volume(x, A.grid, extras)


@dataclass(frozen=True)
class _Steps:
    """Checked settings of ``fast``, and the power of ``_power``."""

    passes: int
    coarse_passes: int
    levels: int
    relaxation: float
    margin: float
    floor: float
    power: float


def _from_coarse_to_fine(
    A: Projector,
    p: NDArray[Any],
    pixels: Mask | None,
    steps: _Steps,
    best: BestPass,
    callback: Callback | None = None,
) -> tuple[Singles, bool]:
    """Return the volume before it is denoised, and False if the callback stopped it."""
    factors = _factors(A.domain_shape, A.range_shape[1:], steps.levels)
    numbers = [steps.passes if f == 1 else steps.coarse_passes * f // 2 for f in factors]
    listener = Listener(callback, len(A) * sum(numbers))
    done, x, grid = 0, np.zeros((2, 2, 2), np.float32), A.grid
    outside = level = None
    for factor, number in zip(factors, numbers, strict=True):
        level = _level(A, p, pixels, factor, steps.margin, outside)
        x = interpolated(x, grid, level.A.grid) if done else np.zeros(level.A.domain_shape, "f4")
        grid = level.A.grid
        fewer = min(1.0, float(np.mean(x.shape)) / len(A))
        first, last = steps.relaxation, steps.relaxation * float(fewer**steps.power)
        falls = number if best.watches and factor == 1 else 1
        shares = np.tile(np.geomspace(first, last, number * len(A) // falls), falls)
        views = np.tile(spread_order(len(A)), number)
        work = WorkingVolume(level.A.kernels, x)
        for used, (share, view) in enumerate(zip(shares, views, strict=True), start=1):
            square, rays = level.update(work, int(view), float(share), steps.floor, listener.wanted)
            ended = best.watches and factor == 1 and used % len(A) == 0
            if ended and best.is_over(work.array):
                break
            if listener(0, done, square, rays, work):
                return interpolated(work.array, grid, A.grid), False
            done += 1
        x = work.array
        del work  # frees the card
        if factor == 2:
            outside = _outside(A, level, x)
    return x, True


def _power(p: NDArray[Any], pixels: Mask | None, seen: KnownNoise | None) -> float:
    """Return the power of voxels along an axis over views by which the relaxation falls.

    It is 1 where line integrals have less noise than ``QUIET`` of their range, and 2 from twice as
    much on: each voxel then takes the mean of more views.
    """
    if seen is None:
        return 1.0
    from twinct.recon.air import DARKEST

    views = range(0, len(p), -(-len(p) // MOST_VIEWS))
    images = np.stack([masked_image(p, view, pixels)[::2, ::2] for view in views])
    more = float(np.exp(np.clip(images, 0, DARKEST)).mean(dtype=np.float64))
    noisy = float(seen.in_air.mean()) * np.sqrt(more) / max(float(np.percentile(images, 99)), 1e-6)
    return 1.0 + float(np.clip(np.log2(noisy / QUIET), 0.0, 1.0))


def _strength(
    A: Projector,
    p: NDArray[Any],
    pixels: Mask | None,
    x: Singles,
    seen: KnownNoise | None,
    steps: _Steps,
) -> tuple[float, str | None]:
    """Return the strength of the denoising, and the source of the noise: None if it is unknown."""
    of_volume = noise(x)
    if seen is None and of_volume is None:
        log.warning(
            "the volume was not denoised: it has no homogeneous parts, the number of photons is "
            "unknown and the projections show no noise in air; state the strength "
            "(reconstruction.denoising)"
        )
        return 0.0, None
    if seen is None:
        assert of_volume is not None
        log.info("noise of %.3g in homogeneous parts of the volume", of_volume)
        return SHARE * of_volume, "volume"
    deviation = _propagated(A, p, pixels, seen, steps)
    log.info(
        "noise of %.3g in the volume, from that of %.3g of line integrals in the free beam (%s)",
        deviation,
        seen.in_air.mean(),
        seen.source,
    )
    if of_volume is None:
        return SHARE_IN_THIN_PARTS * deviation, seen.source
    if SHARE * of_volume <= MOST_OF_PHOTONS * deviation:
        return SHARE * of_volume, "volume"
    log.info("homogeneous parts of the volume have more, %.3g, which is texture", of_volume)
    return MOST_OF_PHOTONS * deviation, seen.source


def _propagated(
    A: Projector, p: NDArray[Any], pixels: Mask | None, seen: KnownNoise, steps: _Steps
) -> float:
    """Return the deviation that noise of the line integrals leaves in the volume.

    Noise alone is reconstructed by the same steps, without bounds. A smaller scan stands for a
    large one: by a factor fewer views, and fewer, larger voxels and pixels along each axis. Its
    relaxation falls alike. The variance is proportional to 1 / (views * voxel^2), and so it is
    smaller by this factor.
    """
    from twinct.recon.air import deviation_of, noise_like

    shortest = min(*A.domain_shape, *A.range_shape[1:])
    factor = 1
    while shortest >= 2 * factor * SMALL and len(A) >= 2 * factor * FEWEST_VIEWS:
        factor *= 2
    views = A.geometry[::factor].binned(factor, factor)
    small = A[::factor].on(coarse_grid(A.grid, 0.0, factor * A.grid.voxel), views)
    mask = pixels if pixels is None or pixels.ndim == 2 else pixels[::factor]
    larger, mask = binned(p[::factor], mask, (factor, factor))
    drawn, _ = _from_coarse_to_fine(
        small,
        noise_like(larger, seen.in_air[::factor]),
        mask,
        replace(steps, floor=LOWEST),
        BestPass(None),
    )
    middle = drawn[tuple(slice(n // 8, n - n // 8) for n in drawn.shape)]
    return deviation_of(np.abs(middle)) * float(np.sqrt(factor))


def _factors(voxels: tuple[int, ...], pixels: tuple[int, ...], levels: int) -> list[int]:
    """Return the factors by which voxels and pixels are larger, level by level."""
    least = min(*voxels, *pixels)
    factors = [2**n for n in reversed(range(levels))]
    return [factor for factor in factors if factor == 1 or least // factor >= SMALLEST]


@dataclass(frozen=True, eq=False)
class _Outside:
    """Line integrals of the grid's surroundings, in pixels that are twice as large."""

    images: Singles

    def at(self, view: int, shape: tuple[int, ...]) -> Singles:
        """Return one view in the scan's own pixels, bilinear."""
        image = self.images[view]
        for axis, pixels in enumerate(shape):
            middles = np.arange(0.5, pixels) / 2 - 0.5
            image = resampled(image, middles, axis)
        return image


@dataclass(frozen=True, eq=False)
class _Level:
    """Scan in voxels and pixels that may be larger by a factor."""

    A: Projector
    p: NDArray[Any]
    pixels: Mask | None
    outside: _Outside | None

    def update(
        self, work: WorkingVolume, view: int, relaxation: float, floor: float, wanted: bool
    ) -> tuple[float, int]:
        """Apply SART's update in place; return the previous sum of squared residuals, and the rays.

        Both are 0 unless ``wanted``.
        """
        measured, mask = masked_image(self.p, view, self.pixels), mask_of(self.pixels, view)
        if self.outside is not None:
            measured = measured - self.outside.at(view, measured.shape)
        estimate, counts = self.A.update(
            work.held, view, measured, relaxation=relaxation, mask=mask, floor=floor
        )
        work.changed()
        if not wanted:
            return 0.0, 0
        return residual_of(measured, estimate, counts)


def _level(
    A: Projector,
    p: NDArray[Any],
    pixels: Mask | None,
    factor: int,
    margin: float,
    outside: _Outside | None,
) -> _Level:
    if factor == 1:
        return _Level(A, p, pixels, outside)
    views = A.geometry.binned(factor, factor)
    coarse = A.on(_with_margin(views, A.grid, factor, margin), views)
    return _Level(coarse, *binned(p, pixels, (factor, factor)), None)


def _with_margin(views: ScanGeometry, grid: VolumeGrid, factor: int, margin: float) -> VolumeGrid:
    """Return the grid of a level; raise InputError unless it lies in front of all sources."""
    size = margin * grid.size_mm
    wide = coarse_grid(grid, size, factor * grid.voxel)
    try:
        check_grid(views, wide)
    except InputError as error:
        text = f"with a margin of {margin:g} ({size.max():.0f} mm)"
        raise InputError(f"{text}, {one}" for one in error.problems) from None
    return wide


def _check(settings: Fast, views: ScanGeometry, grid: VolumeGrid) -> None:
    """Check the coarsest grid."""
    factor = _factors(grid.shape, views.panel.shape, settings.levels)[0]
    if factor == 1:
        return
    try:
        _with_margin(views, grid, factor, settings.margin)
    except InputError as error:
        raise InputError(f"reconstruction.margin: {one}" for one in error.problems) from None


def _outside(A: Projector, level: _Level, x: Singles) -> _Outside:
    """Return the contribution of the last coarse level's margin to the line integrals."""
    inner = level.A.on(coarse_grid(A.grid, 0.0, 2 * A.grid.voxel))
    images = level.A(x)
    middle = [
        slice((n - m) // 2, (n + m) // 2) for n, m in zip(x.shape, inner.domain_shape, strict=True)
    ]
    own = np.ascontiguousarray(x[tuple(middle)])
    for view, image in enumerate(images):
        image -= inner[view](own)[0]
    return _Outside(images)


def _solve(problem: Problem, settings: Fast) -> Volume:
    return solve_by(fast, problem, settings, nonnegative=not settings.allow_negative)


FAST = Algorithm(
    Fast,
    _solve,
    volumes=2.2,
    projections=0.5,
    check=_check,
    updates=lambda own, views: (
        views * (own.passes + own.coarse_passes * (2 ** (own.levels - 1) - 1))
    ),
)
