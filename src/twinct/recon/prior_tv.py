"""Total variation with an earlier volume, for few views of an object that was scanned before."""

from __future__ import annotations

import logging
import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from twinct.core.errors import InputError
from twinct.core.foreign_text import quoted
from twinct.core.settings import NonNegative, Positive, Section, Vector, facts, setting
from twinct.geometry import Pose, ScanGeometry, VolumeGrid
from twinct.recon.air import known_noise
from twinct.recon.algorithm import Algorithm, AlgorithmSettings, Problem, solve_by
from twinct.recon.checks import Mask, start_volume
from twinct.recon.engine import Singles
from twinct.recon.fista import KnownBefore, Variation, minimised
from twinct.recon.left_out import judged_by_left_out_views
from twinct.recon.levels import density
from twinct.recon.order import subset_number
from twinct.recon.prepared import Prepared
from twinct.recon.projector import LOWEST, Projector
from twinct.recon.registration import covered, means_at, moved, registered
from twinct.recon.regularisation import strength_of_noise
from twinct.recon.shared_keys import Iterations, Nonnegative, Subsets
from twinct.recon.steps import Callback
from twinct.recon.volume import Volume

log = logging.getLogger(__name__)

DENSEST = 20.0
"""Largest plausible attenuation, 1/mm, above which the unit is wrong; gold has 10 at 80 keV."""

ROUND, MOST_ROUNDS = 6, 4
"""Iterations per round and largest number of rounds, by default.

New structures in ``bench_prior`` have 70 % of their contrast after the first round and 97 % after
the fourth.
"""

ROUNDS = 2
"""Rounds where the strength follows from the noise; best on the zoo (bench_prior_zoo.py)."""

SHARE, CLOSENESS, FAR = 0.15, 0.06, 0.01
"""Usual share, if left-out views like it, and closeness; difference, relative to dense voxels, from
which voxels count as changed. From the zoo (bench_prior_zoo.py)."""

DARKEST = 8.0
"""Line integral up to which the weight of a ray falls: beyond, other noise is larger."""


class Prior(Section):
    """An earlier volume of the same object."""

    path: Path = Field(description="NIfTI file in 1/mm, such as volume.nii of a run.")
    share: float | None = setting(
        None,
        "Share of the total variation that applies to the difference from the prior instead of the "
        "volume itself. By default 0, 0.15 or 0.5: the one with which four fifths of the views "
        "predict the others best.",
        source="alpha of PICCS: Chen, Tang and Leng, Med. Phys. 35 (2008)",
        ge=0,
        le=1,
    )
    closeness: NonNegative | None = Field(
        default=None,
        description="Weight of the difference of single voxels from the prior, relative to the "
        "mean curvature of the data term; differences above 1 % of the prior's dense voxels count "
        "linearly. By default 0.06, or 0 without regularisation.",
    )
    position_mm: Vector = setting(
        (0.0, 0.0, 0.0),
        "Position of the prior's world in the scan's world at the start of the registration.",
    )
    rotation_deg: Vector = setting(
        (0.0, 0.0, 0.0),
        "Rotation of the prior's world at the start of the registration: extrinsic rotations "
        "about x, y, z.",
    )

    @property
    def start(self) -> Pose:
        """Initial pose of the prior's world in the scan's world."""
        return Pose.from_euler(self.position_mm, self.rotation_deg)

    def __str__(self) -> str:
        """Return a phrase for the scenario in words."""
        share = "" if self.share is None else f" with a share of {self.share:g}"
        return f"{self.path.name}{share}"


class PriorTv(AlgorithmSettings):
    """FISTA with total variation, also of the difference from an earlier volume, for few views."""

    algorithm: Literal["prior_tv"] = "prior_tv"
    iterations: Iterations = 24
    regularisation: NonNegative | None = Field(
        default=None,
        description="Strength of the total variation, as in fast. By default it follows from the "
        "noise of the scenario's photons or of air in the projections; if the noise is unknown, "
        "the value is 0, and log, metrics.json and report say so.",
    )
    rounds: int | None = Field(
        default=None,
        ge=1,
        le=1000,
        description="Number of rounds that the iterations are divided into; after each round, the "
        "residual is added to the line integrals, which restores contrast that the total variation "
        "removed. By default one per 6 iterations, at most 4 with a stated regularisation, else at "
        "most 2.",
        json_schema_extra=facts(source="Osher et al., Multiscale Model. Simul. 4 (2005) 460"),
    )
    subsets: Subsets = None
    weighting: Literal["uniform", "counts"] | None = Field(
        default=None,
        description="Weight of each pixel; counts: its transmission times the view's mAs, relative "
        "to the source's mAs, for Poisson noise. By default counts if the regularisation follows "
        "from the noise, else uniform.",
    )
    huber: Positive | None = Field(
        default=None,
        description="Residual of a line integral beyond which it counts linearly instead of "
        "quadratically, so that a few wrong pixels have little effect (Huber's loss); 3 times the "
        "noise is usual. null: always quadratically.",
    )
    tv_steps: int = Field(default=10, ge=1, le=1000, description="Denoising steps in each update.")
    nonnegative: Nonnegative = True
    prior: Prior = Field(description="The earlier volume.")

    @model_validator(mode="after")
    def _a_pass_in_each_round(self) -> Self:
        if self.rounds is not None and self.rounds > self.iterations:
            raise ValueError(
                f"rounds: {self.rounds} is more than the number of iterations, {self.iterations}"
            )
        return self


def prior_tv(
    A: Projector,
    line_integrals: ArrayLike,
    prior: Volume,
    *,
    iterations: int = 24,
    regularisation: float | None = None,
    photons: ArrayLike | None = None,
    share: float | None = None,
    closeness: float | None = None,
    start: Pose | None = None,
    rounds: int | None = None,
    subsets: int | None = None,
    tv_steps: int = 10,
    weights: ArrayLike | None = None,
    huber: float | None = None,
    x0: ArrayLike | None = None,
    nonnegative: bool = True,
    mask: ArrayLike | None = None,
    callback: Callback | None = None,
) -> Volume:
    """Minimise residual and total variation, of the volume and of its difference from a prior.

        0.5 |A x - p|_W^2 / d + regularisation * ((1 - share) TV(x) + share TV(x - prior))
        + closeness * sum_j h(x_j - prior_j),   x >= 0,   TV(x) = integral of |grad x| over mm^3

    d is the mean over the grid of A^T W A 1 per mm^3 (see ``minimised``). The first line is prior
    image constrained compressed sensing (Chen, Tang, Leng 2008); h is Huber's loss, 0.5 t^2 and
    linear above 1 % of the prior's dense voxels. The prior is first registered by the projections
    (``registered``), and its means over the grid's voxels are taken (``means_at``). All terms grow
    with the size of changes, not with its square: new structures cost little more than without a
    prior. Where the prior has no values, its share applies to the volume itself.

    Peak memory: 16 volumes, a prior in voxels of this size included (13 if the grid is large: the
    registration stays coarse), or the size of a larger prior, and five times the projections,
    besides that prior, the projections and weights.

    Args:
        A: the projector, with the believed geometry.
        line_integrals: p, (views, rows, columns), mm times the unit of the result.
        prior: the earlier volume, on any grid, in that unit.
        iterations: passes over all views, at least 1.
        regularisation: 0 or more; by default from the noise of the photons or of air, and 0 if it
            is unknown: the prior is then only the start.
        photons: photons of a pixel in the free beam, one number or one for each view, (views,).
        share: share of the difference, 0 to 1; by default 0, 0.15 or 0.5, as views that are left
            out prefer it (``judged_by_left_out_views``), and 0.15 if there are fewer than 10 views.
        closeness: 0 or more; by default 0.06, or 0 without regularisation.
        start: initial pose of the prior's world in the scan's world; by default the identity.
        rounds: from 1 to the number of iterations; by default one for each 6 iterations, at most 4,
            or at most 2 if the regularisation follows from the noise.
        subsets: from 1 to the number of views; by default one for each 10 views.
        tv_steps: dual steps after each update, at least 1.
        weights: W, of the shape of the projections, 0 or more; for Poisson noise the expected
            counts. By default exp(-p) if the regularisation follows from the noise, else 1.
        huber: residual of a line integral beyond which it counts by its size, above 0; by default
            none.
        x0: initial volume, (z, y, x); by default the registered prior.
        nonnegative: x >= 0.
        mask: as in ``sart``.
        callback: called after each update; see ``Step``. True stops.

    Returns:
        The volume; its extras hold ``world_from_prior``, the registered pose; without a given
        share ``left_out``: the choice of the left-out views (``Judged``), or None; and without a
        given strength ``regularisation``: its ``strength``, and ``from``, the source of the noise:
        ``photons``, ``air`` or None.

    Raises:
        InputError: the prior cannot be used (``prior_problems``) or registered; or as in ``sart``.
    """
    checks = Prepared(PRIOR_TV, A, line_integrals, mask)
    p, pixels = checks.p, checks.pixels
    iterations = checks.count("iterations", iterations)
    known_photons = checks.photons(photons)
    if regularisation is not None:
        regularisation = checks.not_negative("regularisation", regularisation)
    if rounds is None:
        most = MOST_ROUNDS if regularisation is not None else ROUNDS
        rounds = max(min(iterations // ROUND, most), 1)
    rounds = checks.count("rounds", rounds, at_most=iterations)
    subsets = checks.count("subsets", subset_number(subsets, len(A)), at_most=len(A))
    tv_steps = checks.count("tv_steps", tv_steps)
    given = checks.weights(weights, pixels)
    huber = checks.huber(huber)
    x0 = checks.start(x0, A.domain_shape)
    if closeness is not None:
        closeness = checks.not_negative("closeness", closeness)
    if share is not None and not 0 <= share <= 1:
        checks.problems.append(f"share is {quoted(share)}; it must be a number from 0 to 1")
    checks.problems += prior_problems(prior, A.grid, start or Pose.identity())
    checks.done((_volumes_beyond(prior, A.grid), 0.0))
    radius, extras = regularisation, dict[str, Any]()
    if radius is None:
        radius, source = _strength(A, p, known_photons, pixels)
        extras["regularisation"] = {"strength": radius, "from": source}
        if source and given is None:
            given = np.exp(-np.clip(p, 0.0, DARKEST))
    pose = registered(A, p, prior, start=start, mask=pixels)
    known, inside = _in_place(prior, pose, A.grid)
    if closeness is None:
        closeness = CLOSENESS if radius > 0 else 0.0
    first = SHARE if share is None else share
    before = KnownBefore(known, inside, first, closeness, FAR * density(known))
    floor = np.float32(0.0 if nonnegative else LOWEST)
    term = partial(Variation, strength=radius, steps=tv_steps, floor=floor)
    if share is None and radius > 0:
        extras["left_out"] = judged = judged_by_left_out_views(
            A, p, before, term, iterations=iterations, weights=given, huber=huber, mask=pixels
        )
        if judged:
            before = replace(before, share=judged.share)
            text = "left-out views: share %g, a residual of %.3f times that without the prior"
            log.info(text, judged.share, judged.ratio)
    result = minimised(
        A,
        p,
        start_volume(A, known if x0 is None else x0, nonnegative),
        term(A, known=before),
        iterations=iterations,
        rounds=rounds,
        subsets=subsets,
        weights=given,
        huber=huber,
        mask=pixels,
        callback=callback,
    )
    return Volume(result.array, result.grid, {"world_from_prior": pose} | extras)


def _volumes_beyond(prior: Volume, grid: VolumeGrid) -> float:
    """Return the memory, in volumes, that the splines of a large prior take beyond the usual peak.

    They are as large as the prior, and are there before all other volumes.
    """
    return max(prior.array.size / math.prod(grid.shape) - PRIOR_TV.volumes, 0.0)


def _strength(
    A: Projector, p: NDArray[Any], photons: NDArray[np.float64] | None, mask: Mask | None
) -> tuple[float, str | None]:
    """Return the strength that the noise requires, and its source; 0 and None if it is unknown."""
    if (seen := known_noise(p, mask, photons)) is None:
        log.warning(
            "no regularisation: the number of photons is not stated, and the projections show no "
            "noise in air; the prior is only the start; state a strength "
            "(reconstruction.regularisation), about 0.0001 for bone and 1e4 photons a pixel"
        )
        return 0.0, None
    strength = strength_of_noise(A, p, seen, mask)
    log.info("regularisation of %.3g, from the noise of line integrals (%s)", strength, seen.source)
    return strength, seen.source


def prior_problems(prior: Volume, grid: VolumeGrid, start: Pose) -> list[str]:
    """Return the reasons why a volume cannot be used as a prior for a grid."""
    values = prior.array
    if not all(np.isfinite(plane).all() for plane in values):
        return ["the prior holds NaN or infinite voxels: all must be finite"]
    low, high = float(values.min()), float(values.max())
    if max(-low, high) > DENSEST:
        return [
            f"the prior has values from {low:g} to {high:g}; it must hold attenuation in 1/mm "
            "(about 0.02 for water); Hounsfield units are 1000 (mu / mu of water - 1)"
        ]
    if low == high:
        return [f"the prior is {low:g} everywhere, so it cannot be registered"]
    there = moved(prior.grid, start)
    if not covered(there, grid).any():
        away = there.world_from_grid.distance_mm(grid.world_from_grid)
        return [
            f"the prior does not overlap the grid: its centre is {away:.0f} mm from the grid's, "
            f"its size is {' x '.join(f'{edge:.0f}' for edge in there.size_mm)} mm; start the "
            "registration where they overlap (prior.position_mm, prior.rotation_deg)"
        ]
    return []


def _in_place(prior: Volume, pose: Pose, grid: VolumeGrid) -> tuple[Singles, Mask]:
    """Return the prior at a grid's voxels, 0 where it has no values, and the mask of its values."""
    there = moved(prior.grid, pose)
    inside = covered(there, grid)
    known = means_at(prior.array, there, grid)
    known[~inside] = 0.0
    return known, inside


def _expected(
    A: Projector, line_integrals: Singles, mask: Mask | None, settings: PriorTv
) -> Singles:
    """Return the registered prior."""
    prior = Volume.read(settings.prior.path)
    pose = registered(A, line_integrals, prior, start=settings.prior.start, mask=mask)
    return _in_place(prior, pose, A.grid)[0]


def _weights(problem: Problem, settings: PriorTv) -> NDArray[np.float32] | None:
    if settings.weighting is None:
        return None
    counts = problem.counts
    return counts if settings.weighting == "counts" else np.ones_like(counts)


def _solve(problem: Problem, settings: PriorTv) -> Volume:
    prior = settings.prior
    others = {
        "prior": Volume.read(prior.path),
        "share": prior.share,
        "closeness": prior.closeness,
        "start": prior.start,
        "weights": _weights(problem, settings),
    }
    volume = solve_by(prior_tv, problem, settings, **others)
    pose: Pose = volume.extras["world_from_prior"]
    position, rotation = pose.to_euler()
    middle = volume.grid.world_from_grid.position
    there = prior.start.apply(pose.inverse().apply(middle))
    prior_facts = {
        "position_mm": position.tolist(),
        "rotation_deg": rotation.tolist(),
        "moved_mm": float(np.linalg.norm(middle - there)),
        "turned_deg": pose.angle_deg(prior.start),
    }
    if judged := volume.extras.get("left_out"):
        prior_facts |= {"share": judged.share, "left_out_ratio": judged.ratio}
    return replace(volume, extras={**volume.extras, "prior": prior_facts})


def _check(settings: PriorTv, views: ScanGeometry, grid: VolumeGrid) -> None:
    """Check the file of the prior."""
    path = settings.prior.path
    if problems := prior_problems(Volume.read(path), grid, settings.prior.start):
        raise InputError([f"reconstruction.prior.path: {path}: {one}" for one in problems])


PRIOR_TV = Algorithm(
    PriorTv,
    _solve,
    volumes=16,
    projections=5,
    expects=_expected,
    updates=lambda own, n: subset_number(own.subsets, n),
    check=_check,
)
