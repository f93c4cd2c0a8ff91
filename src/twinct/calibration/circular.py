"""Geometry of a circular scan from its projections alone, as six numbers of the whole scan.

Source, axis and panel stand to each other alike in all views. A rigid motion of everything and its
scale change no image, so that the source may stay where it is believed: six numbers of the panel
are left, in its own axes. They are moved until pairs of views agree on the planes through both
sources (``epipolar``), with a prior about zero. A scan determines some combinations of the six
hardly at all, such as tilt and height where the cone is narrow: those keep their believed values,
and are named.

Noise in the slopes of plane integrals looks like knowledge: in soft objects most of the normal
matrix is noise, steps become far too short, and spreads far too small. The normal matrix of white
noise, of the size that the pixels have, is therefore subtracted. What pixels do to thin and
dense things is alike in all pairs: it would pull combinations that are hardly determined, such as
the SDD, far from the prior, unless differences count less than their spread says.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from twinct.calibration.epipolar import PlaneDerivatives
from twinct.calibration.freedom import Freedom
from twinct.calibration.plane_integrals import PlaneIntegrals
from twinct.calibration.resection import moved
from twinct.core.progress import SILENT, Progress
from twinct.geometry import Floats, ScanGeometry
from twinct.recon import CircularOrbit, fit_circle
from twinct.recon.checks import Checks
from twinct.recon.resolution import binned

NUMBERS = ("axis_offset", "height", "sdd", "tilt", "slant", "roll")
"""Names of the six numbers: shifts of the panel along u, v and its normal, turns about them."""

ROUNDS = ((50, 20), (100, 12), (200, 25), (400, 10))
"""Pixels along the panel's diagonal, and the largest number of steps.

A panel with fewer pixels is not binned, and has no further round then.
"""

FINEST = ROUNDS[-1][0]

WHAT = "calibrate circle"
"""Name of this calibration in messages."""

SURE = 100
"""Pixels along the diagonal up to which finer pixels always count."""

COMMON = 10.0
"""Number of differences that count as one beyond ``epipolar.ALIKE``, as pixels err alike in all."""

LEAST_SHARE = 0.04
"""Least share of the normal matrix, along each direction, that is not noise."""

MOST_VIEWS = (60, 240)
"""Largest number of views that are compared, spread over the scan; then if that is not precise."""

SHADOW = 0.1
"""Least line integral of an object's shadow, relative to the largest."""

STILL = 0.1
"""Steps end when one moves the numbers by less, in their standard deviations."""

MIXED = 1e-3
"""Smallest singular value of differences of steps that are mixed, relative to the largest."""

STRETCH = 0.3, 6.0
"""Range of a mixed step along each direction, relative to the step itself.

Where the views determine little, differences of steps are mostly noise, and mixing alone runs away.
"""

HARDLY = 0.5
"""Share of the prior's standard deviation above which a combination counts as undetermined."""

FINE_PX, FINE_DEG = 0.1, 0.03
"""Spreads of axis and roll up to which a volume hardly suffers."""

NAMED = 0.35
"""Smallest weight of a number that is named in a combination, relative to the largest."""


@dataclass(frozen=True)
class CircularPrior:
    """Standard deviations of the errors of a circular scan's numbers.

    Attributes:
        offset_px: of the panel along its columns and rows, or of the axis, px.
        sdd: of the distance from source to panel, as a share of it.
        turn_deg: of tilt, slant and roll of the panel against the axis, deg.
        axis_px: of the panel along its columns, px, if it is known otherwise than its height.
    """

    offset_px: float = 5.0
    sdd: float = 0.005
    turn_deg: float = 1.0
    axis_px: float | None = None

    def deviations(self, geometry: ScanGeometry) -> Floats:
        """Return the standard deviation of each of ``NUMBERS``, (6,), mm and rad."""
        panel = geometry.panel
        axis_px = self.offset_px if self.axis_px is None else self.axis_px
        shifts = axis_px * panel.pitch_u, self.offset_px * panel.pitch_v
        far = self.sdd * float(geometry.sdd.mean())
        return np.array([*shifts, far, *[np.radians(self.turn_deg)] * 3])


class Undetermined(NamedTuple):
    """Combination of numbers that the scan hardly determines.

    Attributes:
        parts: names, the largest weight first.
        weights: their weights in prior standard deviations, the largest 1.
        left: share of the prior's standard deviation that is left.
    """

    parts: tuple[str, ...]
    weights: tuple[float, ...]
    left: float

    def __str__(self) -> str:
        """Return the combination in words."""
        parts = zip(self.weights, self.parts, strict=True)
        return ", ".join(f"{weight:+.1f} {part}" for weight, part in parts)


class CircleNumbers(NamedTuple):
    """Numbers of a circular scan, in the terms of an import's ``kind: circle``.

    Attributes:
        axis_px: column of the circle's centre, from the panel's middle column, px.
        height_px: row of the circle's centre, from the panel's middle row, px.
        sod_mm: radius of the circle.
        sdd_mm: distance from the source to the panel's plane, along the radius.
        panel_offset_mm: panel's centre from the foot of the source, (right, up).
        panel_roll_deg: turn of the panel in its plane, clockwise.
        panel_tilt_deg: lean of the panel's upper edge away from the source.
        panel_slant_deg: lean of the panel's right edge away from the source.
    """

    axis_px: float
    height_px: float
    sod_mm: float
    sdd_mm: float
    panel_offset_mm: tuple[float, float]
    panel_roll_deg: float
    panel_tilt_deg: float
    panel_slant_deg: float


@dataclass(frozen=True, eq=False)
class CircularCalibration:
    """Geometry of a circular scan, estimated from pairs of views.

    Attributes:
        geometry: geometry of all views.
        change: change of ``NUMBERS`` from the believed geometry, (6,), mm and rad.
        deviation: standard deviation of each, the prior included, (6,), mm and rad.
        before: numbers of the believed geometry.
        after: numbers of the found one.
        undetermined: combinations that the views hardly determine.
        residuals: spread of the differences between paired views, at the last resolution, in the
            believed geometry and in the found one.
    """

    geometry: ScanGeometry
    change: Floats
    deviation: Floats
    before: CircleNumbers
    after: CircleNumbers
    undetermined: tuple[Undetermined, ...]
    residuals: tuple[float, float]

    @property
    def uncertain(self) -> tuple[str, ...]:
        """Axis and roll, in words, where their spread exceeds ``FINE_PX`` and ``FINE_DEG``."""
        axis_px = float(self.deviation[0]) / self.geometry.panel.pitch_u
        roll_deg = float(np.degrees(self.deviation[5]))
        deviations = (("axis", axis_px, FINE_PX, "px"), ("roll", roll_deg, FINE_DEG, "deg"))
        return tuple(
            f"{name} +- {of:.2g} {unit}" for name, of, fine, unit in deviations if of > fine
        )


def circular_consistent(
    line_integrals: NDArray[np.float32],
    believed: ScanGeometry,
    prior: CircularPrior | None = None,
    *,
    mask: NDArray[np.bool_] | None = None,
    progress: Progress = SILENT,
) -> CircularCalibration:
    """Move the panel of a circular scan, alike in all views, until pairs of views agree.

    Args:
        line_integrals: (views, rows, columns).
        believed: approximate geometry, a circle.
        prior: spread of the errors.
        mask: True where a pixel counts, (rows, columns) or (views, rows, columns).
        progress: receives a step for each resolution.

    Raises:
        InputError: the geometry is no circle, or arrays have other shapes or values that are not
            finite.
        CalibrationError: no view has enough usable planes.
    """
    circle = fit_circle(believed, WHAT)
    checks = Checks((len(believed), *believed.panel.shape))
    p, pixels = checks.projections(line_integrals, mask)
    checks.done()
    deviations = (prior or CircularPrior()).deviations(believed)

    def found_in(most: int, start: Floats) -> CircularCalibration:
        some = np.unique(np.linspace(0, len(p) - 1, min(len(p), most)).round().astype(int))
        of_views = pixels[some] if pixels is not None and pixels.ndim == 3 else pixels
        pairs = _Pairs(p[some], of_views, believed[some], circle)
        return _calibrated(pairs, believed, deviations, start, progress)

    result = found_in(MOST_VIEWS[0], np.zeros(6))
    for fewer, most in pairwise(MOST_VIEWS):
        if result.uncertain and len(p) > fewer:
            result = found_in(most, result.change)
    return result


def _calibrated(
    pairs: _Pairs, believed: ScanGeometry, deviations: Floats, start: Floats, progress: Progress
) -> CircularCalibration:
    """Return what some views tell of the geometry of all, from a start at six numbers."""
    precision = np.diag(deviations**-2.0)
    first = pairs.seen(np.zeros(6), FINEST).spread
    change, information, across, drift = _found(pairs, deviations, start, progress)
    told = _covariance(information, pairs.scatter(change, across), drift)
    covariance: Floats = np.asarray(np.linalg.inv(np.linalg.inv(told) + precision), np.float64)
    # What the views alone tell, then with the prior: it counts more than in the steps.
    alone = change + np.linalg.solve(information, precision @ change)
    change = covariance @ np.linalg.solve(told, alone)
    last = pairs.seen(change, FINEST).spread
    geometry = _moved(believed, change)
    return CircularCalibration(
        geometry,
        change,
        np.sqrt(np.diag(covariance)),
        circle_numbers(believed, pairs.circle),
        circle_numbers(geometry, pairs.circle),
        _undetermined(covariance, deviations),
        (first, last),
    )


def _found(
    pairs: _Pairs, deviations: Floats, start: Floats, progress: Progress
) -> tuple[Floats, Floats, int, Floats]:
    """Return numbers, normal matrix and pixels of the last round that counts, and its change."""
    precision = np.diag(deviations**-2.0)
    change, information, across = start, np.zeros((6, 6)), FINEST
    drift = np.zeros(6)
    with progress.stage("circle", len(ROUNDS)) as step:
        for number, (pixels_across, steps) in enumerate(ROUNDS):
            if number == 0 or pairs.factor(pixels_across) < pairs.factor(ROUNDS[number - 1][0]):
                agreement, normal = pairs.agreed(change, pixels_across, steps, deviations)
                # Finer pixels of noisy views may tell less.
                if pixels_across <= SURE or _knowledge(normal, precision) > _knowledge(
                    information, precision
                ):
                    drift = agreement - change if number else drift
                    change, information, across = agreement, normal, pixels_across
            step()
    return change, information, across, drift


def _knowledge(normal: Floats, precision: Floats) -> float:
    return float(np.linalg.slogdet(normal + precision)[1])


def _covariance(normal: Floats, scatter: Floats, drift: Floats) -> Floats:
    """Return the covariance of the six numbers as the views alone determine them.

    Residuals show what noise and a badly modelled view do. What pixels do is alike in all views:
    it shows in the change that finer pixels made.

    Args:
        normal: normal matrix without the prior, (6, 6).
        scatter: covariance of the right side of the equations, (6, 6).
        drift: change by the last, finer pixels, (6,).
    """
    covariance = np.linalg.inv(normal)
    return covariance + covariance @ scatter @ covariance + np.outer(drift, drift)


def _moved(geometry: ScanGeometry, six: Floats) -> ScanGeometry:
    return moved(geometry, np.concatenate([np.zeros(3), six]))


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Chosen views of a scan."""

    p: NDArray[np.float32]
    mask: NDArray[np.bool_] | None
    believed: ScanGeometry
    circle: CircularOrbit

    def factor(self, across: int) -> int:
        """Return the number of pixels along each edge that are binned into one."""
        return max(round(float(np.hypot(*self.believed.panel.shape)) / across), 1)

    def seen(self, change: Floats, across: int) -> PlaneDerivatives:
        """Compare all pairs at a resolution."""
        factor = self.factor(across)
        geometry = _moved(self.believed, change).binned(factor, factor)
        coarse, counts = binned(self.p, self.mask, (factor, factor))
        return PlaneDerivatives.of(
            geometry, self.circle.centre, PlaneIntegrals(coarse, geometry, counts)
        )

    def agreed(
        self, change: Floats, across: int, steps: int, deviations: Floats
    ) -> tuple[Floats, Floats]:
        """Move the numbers until the views agree; return them and the normal matrix.

        Steps are mixed as Anderson does (J. ACM 12 (1965) 547): those of the last steps show how
        far a step should have gone.
        """
        precision, normal = np.diag(deviations**-2.0), np.zeros((6, 6))
        noise, of_noise = self.noise(change, across)
        tried: list[Floats] = []
        ons: list[Floats] = []
        for _ in range(steps):
            seen, raw, right = self.equations(change, across)
            size = min(self.pixel_noise, seen.spread / of_noise)
            normal = _without(raw, noise * size**2, deviations) / COMMON
            right /= COMMON
            hessian = normal + precision
            on = np.asarray(np.linalg.solve(hessian, right - precision @ change), np.float64)
            tried.append(change)
            ons.append(on)
            change = change + on
            if len(ons) > 1:
                by_on, by_place = np.diff(ons, axis=0).T, np.diff(tried, axis=0).T
                root = np.linalg.cholesky(hessian).T
                share = np.linalg.lstsq(root @ by_on, root @ on, rcond=MIXED)[0]
                mixed = on - (by_place + by_on) @ share
                change = tried[-1] + _stretched(on, mixed, hessian, deviations)
            if COMMON * (on @ hessian @ on) < STILL**2:
                break
        return change, normal

    def equations(self, change: Floats, across: int) -> tuple[PlaneDerivatives, Floats, Floats]:
        """Return the compared planes, their normal matrix, (6, 6), and their right side, (6,)."""
        seen = self.seen(change, across)
        tangents = self._tangents(change, across)
        return seen, *seen.shared_equations(seen.weights(), tangents)

    def scatter(self, change: Floats, across: int) -> Floats:
        """Return the covariance of the right side of the equations, (6, 6), from the residuals.

        Pairs with a view in common err together (Aronow et al., Political Analysis 23 (2015) 564).
        """
        seen = self.seen(change, across)
        pulls = seen.shared_pulls(seen.weights(), self._tangents(change, across)) / COMMON
        of_views = np.zeros((len(self.believed), 6))
        for side in seen.pairs.sides:
            np.add.at(of_views, side, pulls)
        values, vectors = np.linalg.eigh(of_views.T @ of_views - pulls.T @ pulls)
        return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T, np.float64)

    @cached_property
    def pixel_noise(self) -> float:
        """Noise of a pixel in the shadow (Immerkaer, Comput. Vis. Image Underst. 64 (1996) 300)."""
        p = self.p
        rough = 2 * p[:, 1:-1] - p[:, :-2] - p[:, 2:]
        rough = 2 * rough[..., 1:-1] - rough[..., :-2] - rough[..., 2:]
        shadow = p[:, 1:-1, 1:-1] > SHADOW * p.max()
        return 1.4826 / 6 * float(np.median(np.abs(rough[shadow]))) if shadow.any() else 0.0

    def noise(self, change: Floats, across: int) -> tuple[Floats, float]:
        """Return the normal matrix of white noise of 1 on these planes, and their spread."""
        seen = self.seen(change, across)
        rng = np.random.default_rng(0)
        white = replace(self, p=rng.standard_normal(self.p.shape, np.float32))
        seen_noise = replace(white.seen(change, across), used=seen.used)
        normal, _ = seen_noise.shared_equations(seen.weights(), self._tangents(change, across))
        return normal, seen_noise.spread

    def _tangents(self, change: Floats, across: int) -> Floats:
        each = np.tile(np.concatenate([np.zeros(3), change]), (len(self.believed), 1))
        free = Freedom("arms", self.circle.centre)
        return free.tangents(self.believed, each, self.factor(across))[:, 3:]


def _stretched(on: Floats, mixed: Floats, hessian: Floats, deviations: Floats) -> Floats:
    """Return a mixed step that goes the way of the step along each direction of the hessian."""
    _, vectors = np.linalg.eigh(deviations[:, None] * hessian * deviations)
    own, other = vectors.T @ (on / deviations), vectors.T @ (mixed / deviations)
    ratio = np.divide(other, own, out=np.ones(6), where=np.abs(own) > 1e-12)
    return deviations * (vectors @ (own * np.clip(ratio, *STRETCH)))


def _without(normal: Floats, noise: Floats, deviations: Floats) -> Floats:
    """Return a normal matrix without the part of noise, of which some is left everywhere."""
    whole = deviations[:, None] * normal * deviations
    values, vectors = np.linalg.eigh(whole - deviations[:, None] * noise * deviations)
    least = LEAST_SHARE * np.einsum("ik,ij,jk->k", vectors, whole, vectors)
    rest = (vectors * np.maximum(values, least)) @ vectors.T
    return rest / np.outer(deviations, deviations)


def _undetermined(covariance: Floats, deviations: Floats) -> tuple[Undetermined, ...]:
    """Return the combinations of which much of the prior's deviation is left."""
    values, vectors = np.linalg.eigh(covariance / np.outer(deviations, deviations))
    undetermined: list[Undetermined] = []
    for value, vector in zip(values[::-1], vectors.T[::-1], strict=True):
        left = float(min(value, 1.0) ** 0.5)
        if left < HARDLY:
            break
        order = np.argsort(-np.abs(vector))
        weights = vector[order] / vector[order[0]]
        named = int((np.abs(weights) >= NAMED).sum())
        parts = tuple(NUMBERS[i] for i in order[:named])
        undetermined.append(Undetermined(parts, tuple(weights[:named].tolist()), left))
    return tuple(undetermined)


def circle_numbers(geometry: ScanGeometry, circle: CircularOrbit | None = None) -> CircleNumbers:
    """Return the numbers of a circular scan, each the mean over the views.

    Args:
        geometry: the views.
        circle: circle of their sources; fitted by default.

    Raises:
        InputError: the geometry is no circle.
    """
    circle = circle or fit_circle(geometry, WHAT)
    up = circle.axis * (1.0 if float((geometry.v @ circle.axis).mean()) > 0 else -1.0)
    beam = circle.centre - geometry.source
    beam = beam - np.outer(beam @ up, up)
    beam /= np.linalg.norm(beam, axis=1, keepdims=True)
    right = np.cross(beam, up)
    machine = np.stack([right, beam, np.broadcast_to(up, beam.shape)], axis=1)
    to_panel, u, v = (
        np.einsum("vij,vj->vi", machine, vectors)
        for vectors in (geometry.detector - geometry.source, geometry.u, geometry.v)
    )
    facing = Rotation.from_matrix(np.stack([u, np.cross(v, u), v], axis=2)).mean()
    roll, slant, back = facing.as_euler("yzx", degrees=True)
    across, along, above = to_panel.mean(axis=0)
    column, row = geometry.project(circle.centre)[:, 0].mean(axis=0) - geometry.panel.middle
    return CircleNumbers(
        axis_px=float(column),
        height_px=float(row),
        sod_mm=circle.radius,
        sdd_mm=float(along),
        panel_offset_mm=(float(across), float(above)),
        panel_roll_deg=float(roll),
        panel_tilt_deg=-float(back),
        panel_slant_deg=float(slant),
    )
