"""Reconstruction of a scan as its scenario states: any algorithm, checkpoints, observers."""

from __future__ import annotations

import hashlib
import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.core.arguments import kinds_checked
from twinct.core.draws import view_rng
from twinct.core.errors import InputError
from twinct.core.interruption import keeping
from twinct.geometry import ScanGeometry
from twinct.observers import Audience, IterationDone, Observers, audience_of
from twinct.recon.algorithm import Algorithm, AlgorithmSettings, Problem
from twinct.recon.algorithms import algorithms
from twinct.recon.known_components import implant_bytes
from twinct.recon.memory import advice, peak_bytes, refuse_if_short
from twinct.recon.metal import WithoutMetal, metal_bytes
from twinct.recon.projector import Projector, check_grid
from twinct.recon.surroundings import check_margin, surroundings_bytes, without_surroundings
from twinct.recon.unexplained import compared_views
from twinct.recon.volume import Volume
from twinct.runs.checkpoints import Checkpoints, Follower
from twinct.runs.checks import check_engine
from twinct.runs.implants import (
    ScanWithoutImplants,
    check_implants,
    volumes_of,
    without_implants_of,
)
from twinct.runs.integrals import hardening_bytes, hardening_corrected
from twinct.runs.known_motion import gated_scan, motion_bytes, projector_of, views_that_count
from twinct.runs.metal_reduction import doubts, metal_replaced
from twinct.runs.model_doubts import (
    doubt_of_grid,
    doubt_of_prior,
    judged_by_rays,
)
from twinct.runs.scatter_correction import scatter_bytes, scatter_subtracted
from twinct.runs.truth import held_bytes
from twinct.scan import Scan
from twinct.scenario import (
    KnownImplants,
    Nmar,
    Reconstruction,
)
from twinct.scenario.imported import ScanSettings, reconstructed_by

log = logging.getLogger(__name__)


Function = Callable[[Projector, NDArray[np.float32]], ArrayLike]
"""``f(A, y)``: from the projector and line integrals to a volume (z, y, x), 1/mm."""


@kinds_checked
def reconstruct(
    scan: Scan,
    *,
    algorithm: str | Function | None = None,
    geometry: str | ScanGeometry | None = None,
    mask: ArrayLike | None = None,
    checkpoints: Path | None = None,
    watch: Callable[[int, float], None] | None = None,
    observers: Observers = (),
    **settings: Any,
) -> Volume:
    """Reconstruct a scan as its scenario states, or with other settings.

    Args:
        scan: projections and poses.
        algorithm: replaces the scenario's algorithm, and inherits the keys that both have. Also a
            function ``f(A, y)`` of the projector and the line integrals (views, rows, columns),
            corrected as the scenario states, that returns the volume (z, y, x).
        geometry: ``commanded``, ``executed``, ``believed`` or the name of a derived geometry, or a
            geometry itself; None: the scenario's first.
        mask: True where a pixel counts, (rows, columns) or (views, rows, columns), bool. Bad pixels
            never count, unless the algorithm supports no mask.
        checkpoints: folder for a checkpoint of each iteration. A later call with the same
            projections, poses, mask and settings continues from it, if the algorithm can resume.
        watch: called after each iteration, and for each iteration of a resumed call, with its
            number from 1 and the root mean square of p - A x, taken before each update; not called
            by algorithms without residuals.
        observers: notified of each iteration, with its volume.
        **settings: other values of keys of the section ``reconstruction``, such as
            ``iterations=3`` or ``grid={"voxels": 64, "voxel_mm": 2.5}``.

    Returns:
        Attenuation, 1/mm.

    Raises:
        MissingExtraError: the algorithm is not installed.
        InputError: the algorithm does not support the scan or the mask, the poses form no valid
            geometry, or the memory is too small.
    """
    function = algorithm if callable(algorithm) else None
    name = _BARE if function else cast("str | None", algorithm)
    if name is not None or settings:
        scan = scan.with_settings(reconstructed_by(scan.settings, name, settings))
    solver = algorithms()[scan.settings.reconstruction.algorithm]
    if function:
        solver = Algorithm(_Bare, partial(_solved_by, function), volumes=1, masks=False)
    with audience_of(observers) as audience:
        return _reconstruct(scan, solver, geometry, mask, checkpoints, watch, audience)


_BARE = "fdk"
"""Algorithm without iterations, whose keys a function shares."""


class _Bare(AlgorithmSettings):
    """Settings of a function, which has none."""

    algorithm: Literal["function"] = "function"


def _solved_by(function: Function, problem: Problem, settings: AlgorithmSettings) -> Volume:
    grid = problem.projector.grid
    x = np.asarray(function(problem.projector, problem.line_integrals))
    if x.shape != grid.shape or x.dtype.kind not in "fiu":
        raise InputError(
            f"algorithm: the function returned {x.dtype} of shape {x.shape}: the grid needs "
            f"numbers of shape {grid.shape} (z, y, x)"
        )
    return Volume(x, grid)


def _reconstruct(
    scan: Scan,
    algorithm: Algorithm[Any],
    geometry: str | ScanGeometry | None,
    mask: ArrayLike | None,
    checkpoints: Path | None,
    watch: Callable[[int, float], None] | None,
    audience: Audience,
) -> Volume:
    stated, section = scan.settings, scan.settings.reconstruction
    which = "given" if isinstance(geometry, ScanGeometry) else geometry or section.geometries[0]
    pixels = _good_pixels(scan, algorithm, mask)
    poses = geometry if isinstance(geometry, ScanGeometry) else _poses(scan, which)
    _require_fit(scan, poses)
    if (views := views_that_count(stated, scan.middle_s)) is not None:
        scan, poses, pixels = gated_scan(scan, poses, pixels, views)
    grid = section.volume_grid
    folder = checkpoints if algorithm.resumes else None
    saved = Checkpoints(folder, f"{which}-{_digest(scan, poses, pixels)[:16]}" if folder else "")
    done, x0, residuals = saved.newest(grid)
    watch = watch or (lambda number, residual: None)
    for number, residual in enumerate(residuals, start=1):
        watch(number, residual)
    iterations: int = getattr(section, "iterations", 1)
    finished = x0 if done >= iterations else None
    if finished is not None and section.metal is None:
        if (results := saved.results()) is not None:
            return _counted(Volume(finished, grid, results), section, done)
    # Only here: few modules at the start.
    scan = scatter_subtracted(scan, poses, audience)
    A = projector_of(scan, poses, grid)
    integrals, metal, warnings = _corrected(scan, A, algorithm, pixels, audience)
    if finished is not None:
        volume = Volume(finished, grid)
    else:
        problem = Problem(
            projector=A,
            line_integrals=integrals,
            transmission=scan.transmission,
            exposures=scan.exposures_rel,
            photons=scan.photons,
            alone=section.around is not None,
            predicted_views=compared_views(len(A)),
            mask=pixels,
            x0=x0,
            rng=view_rng(stated.seed, "order of views", 0),
        )
        name = _stage(algorithm, geometry, which)
        course = _Course(done, residuals, watch, (algorithm.name, which))
        volume = _solved(algorithm, problem, section, course, saved, name, audience)
    volume, doubt = judged_by_rays(
        _counted(volume, section, done), A, integrals, scan, pixels, residuals
    )
    _warn(audience, warnings, doubt, doubt_of_prior(volume))
    if warnings:
        volume = replace(volume, extras={**volume.extras, "warnings": warnings})
    saved.keep_results(volume)
    return metal.put_back(volume) if metal else volume


@dataclass(frozen=True)
class _Course:
    """Passes of a reconstruction: those already done, their residuals, and who hears of them."""

    done: int
    residuals: list[float]
    watch: Callable[[int, float], None]
    named: tuple[str, str]


def _solved(
    algorithm: Algorithm[Any],
    problem: Problem,
    section: Reconstruction,
    course: _Course,
    saved: Checkpoints,
    name: str,
    audience: Audience,
) -> Volume:
    """Return the volume of an algorithm, with progress, events and checkpoints."""
    iterations: int = getattr(section, "iterations", 1)
    done, grid = course.done, problem.projector.grid
    if done:
        section = section.model_copy(update={"iterations": iterations - done})
    updates = algorithm.updates(section, len(problem.projector))

    def on_iteration(iteration: int, residual: float, volume: NDArray[np.float32]) -> None:
        course.watch(iteration, residual)
        if audience.wants(IterationDone):
            now = iteration, iterations, residual, Volume(volume.copy(), grid)
            audience.tell(IterationDone(*course.named, *now))

    prepares = algorithm.prepares(section, len(problem.projector))
    total = prepares + iterations * updates
    stage = audience.stage(name, total, done * updates)
    with keeping(lambda: saved.in_words(iterations)), stage as tick:
        left = total - done * updates
        follower = Follower(tick, saved, on_iteration, done, course.residuals, prepares, left)
        problem = replace(problem, callback=follower, preparing=follower.prepare)
        volume = algorithm.solve(problem, section)
        follower.finish()
    return volume


def _warn(audience: Audience, warnings: list[str], *texts: str | None) -> None:
    """Tell the user and the log all warnings that there are, and add them to a list."""
    for text in filter(None, texts):
        log.warning(text)
        audience.say(text, warning=True)
        warnings.append(text)


def _stage(algorithm: Algorithm[Any], geometry: str | ScanGeometry | None, which: str) -> str:
    """Return the name of a stage; a geometry that was given has no name."""
    given = isinstance(geometry, ScanGeometry)
    return algorithm.name if given else f"{algorithm.name}, {which} geometry"


def _corrected(
    scan: Scan,
    A: Projector,
    algorithm: Algorithm[Any],
    pixels: NDArray[np.bool_] | None,
    audience: Audience,
) -> tuple[NDArray[np.float32], WithoutMetal | ScanWithoutImplants | None, list[str]]:
    """Return the line integrals as the scenario corrects them, metal to put back, and warnings."""
    stated, section = scan.settings, scan.settings.reconstruction
    integrals, warnings = scan.line_integrals(), list[str]()
    metal: WithoutMetal | ScanWithoutImplants | None = None
    if isinstance(section.metal, KnownImplants):
        with audience.stage("implants", volumes_of(section.metal) * len(A)) as tick:
            known = stated, section.metal, integrals, A, pixels
            metal = without_implants_of(*known, lambda _: tick())
        integrals = metal.line_integrals
    else:
        integrals = hardening_corrected(stated, integrals, A, pixels)
    whole = integrals
    if section.around is not None:
        integrals = _grid_alone(A, integrals, section, algorithm, pixels, audience)
    else:
        _warn(audience, warnings, doubt_of_grid(A, integrals, pixels))
    if isinstance(section.metal, Nmar):
        with audience.stage("metal", section.metal.first_iterations * len(A)) as tick:
            images = integrals, whole, A, pixels
            metal = metal_replaced(scan, section.metal, *images, lambda _: tick())
        integrals = metal.line_integrals
        _warn(audience, warnings, doubts(metal))
    return integrals, metal, warnings


def _poses(scan: Scan, which: str) -> ScanGeometry:
    try:
        return scan.geometry(which)
    except ValueError as error:
        raise InputError(f"{which} poses: {error}") from None


def _require_fit(scan: Scan, geometry: ScanGeometry) -> None:
    panel, images = geometry.panel.shape, scan.transmission.shape
    if (len(geometry), *panel) != images:
        raise InputError(
            f"geometry: {len(geometry)} views of {panel} pixels; the scan has {images[0]} of "
            f"{images[1:]}"
        )


def _grid_alone(
    A: Projector,
    integrals: NDArray[np.float32],
    section: Reconstruction,
    algorithm: Algorithm[Any],
    pixels: NDArray[np.bool_] | None,
    audience: Audience,
) -> NDArray[np.float32]:
    """Remove the surroundings of the grid from line integrals.

    An algorithm with ``expects`` predicts the volume in the grid; the surroundings are then removed
    a second time, with this prediction.
    """
    around = section.around
    assert around is not None

    def alone(stage: str, expected: NDArray[np.float32] | None = None) -> NDArray[np.float32]:
        with audience.stage(stage, around.iterations * len(A)) as tick:
            return without_surroundings(
                A,
                integrals,
                **around._asdict(),
                expected=expected,
                mask=pixels,
                callback=lambda _: tick(),
            )

    integrals_alone = alone("surroundings")
    if algorithm.expects is None:
        return integrals_alone
    return alone("surroundings again", algorithm.expects(A, integrals_alone, pixels, section))


def _counted(volume: Volume, section: Reconstruction, before: int) -> Volume:
    """Add the total number of passes to a volume's extras, if the section has a stop criterion."""
    if getattr(section, "stop", None) is None:
        return volume
    passes = before + volume.extras.get("passes", 0)
    log.info("the volume took %d passes", passes)
    return replace(volume, extras={**volume.extras, "passes": passes})


def _good_pixels(
    scan: Scan, algorithm: Algorithm[Any], given: ArrayLike | None
) -> NDArray[np.bool_] | None:
    """Exclude bad pixels from a mask: their filled-in values are no measurements."""
    if not algorithm.masks:
        if given is not None:
            raise InputError(
                f"{algorithm.name} takes no mask: omit it, or choose another algorithm"
            )
        return None
    mask = None if given is None else np.asarray(given)
    if scan.bad_pixels is None:
        return mask
    good = ~scan.bad_pixels
    if mask is None:
        return good
    fits = mask.dtype == np.bool_ and mask.shape[-2:] == good.shape
    return mask & good if fits else mask  # other masks are refused by the algorithm


def memory_needed(settings: ScanSettings, views: ScanGeometry) -> dict[str, int]:
    """Return the peak bytes of each stage of a reconstruction, with the run's other arrays."""
    section = settings.reconstruction
    algorithm = algorithms()[section.algorithm]
    grid = section.volume_grid
    voxels, pixels = math.prod(grid.shape), len(views) * math.prod(views.panel.shape)
    # Transmission and line integrals, the truth and its region.
    held = 8 * pixels + held_bytes(grid)
    stages: dict[str, int] = {}
    if section.scatter is not None:
        stages["scatter"] = held + scatter_bytes(section, pixels)
    if section.beam_hardening is not None:
        stages["beam hardening"] = held + hardening_bytes(section.beam_hardening, voxels, pixels)
    if around := section.around:
        own = surroundings_bytes(views, grid, margin_mm=around.margin_mm, voxel_mm=around.voxel_mm)
        stages["surroundings"] = held + own
        if algorithm.expects is not None:  # plus first line integrals, volume and its projection
            stages["surroundings"] += 8 * pixels + 4 * voxels
    if section.metal is not None:
        # Plus the line integrals with the surroundings.
        stages["metal"] = held + metal_bytes(voxels, pixels) + (4 * pixels if around else 0)
    if isinstance(section.metal, KnownImplants):
        # Plus measured and corrected line integrals, and path lengths in the dense material.
        stages["implants"] = held + 12 * pixels + implant_bytes(voxels, pixels)
    held += motion_bytes(settings, len(views))
    own = peak_bytes(algorithm, voxels, pixels, *algorithm.extra(section))
    stages[algorithm.name] = held + own
    return stages


def require_feasible(settings: ScanSettings, commanded: ScanGeometry) -> None:
    """Raise before any work if the algorithm cannot reconstruct the scan, or memory is too small.

    Raises:
        InputError: an unknown engine, a grid behind a source, no circular scan for ``fdk``, or an
            unusable prior; or too little memory, with the needed and the available amount.
    """
    check_engine(settings)
    section = settings.reconstruction
    algorithm, grid = algorithms()[section.algorithm], section.volume_grid
    check_grid(commanded, grid)
    if around := section.around:
        try:
            check_margin(commanded, grid, around.margin_mm, around.voxel_mm)
        except InputError as error:
            key = "zoom" if section.surroundings is None else "surroundings"
            raise InputError(f"reconstruction.{key}: {one}" for one in error.problems) from None
    if isinstance(metal := section.metal, KnownImplants):
        check_implants(settings, metal, commanded)
    algorithm.check(section, commanded, grid)
    stages = memory_needed(settings, commanded)
    most = max(stages, key=lambda stage: stages[stage])
    refuse_if_short(
        stages[most],
        f"{most} with a grid of {grid.shape} voxels and {len(commanded)} views of "
        f"{commanded.panel.shape} pixels",
        advice(algorithm),
    )


def _digest(scan: Scan, poses: ScanGeometry, mask: NDArray[np.bool_] | None) -> str:
    """Return the SHA-256 of all inputs of a checkpoint, the projections included."""
    digest = hashlib.sha256(scan.provenance.volume_digest("").encode())
    arrays = (poses.source, poses.detector, poses.u, poses.v, scan.transmission)
    for array in arrays if mask is None else (*arrays, mask):
        digest.update(repr((array.shape, array.dtype.str)).encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()
