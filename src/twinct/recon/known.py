"""Implants of known shape: found in the projections, and taken out of the line integrals."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from twinct.errors import InputError
from twinct.geometry import Floats, Pose, ScanGeometry
from twinct.recon.checks import Checks, Mask, mask_of
from twinct.recon.engine import Singles
from twinct.recon.memory import SPARE_BYTES, advice, refuse_if_short
from twinct.recon.projector import Projector
from twinct.recon.sart import sart
from twinct.recon.steps import Callback
from twinct.shadow import Body, Box, Rays

STARVED = 7.0
"""Line integral from which a ray through metal says less than what is expected of it: at 1e5
photons a pixel, 90 of them are left."""
FINEST_PX = 0.7
"""Residuals and their derivatives are blurred by as much, for shadows have steep edges."""
STEEPEST = 10.0
"""Most that a path length changes by with the body's position, mm by mm: at an edge it has no
bound."""
SOME_VIEWS = 50
"""As many, evenly spread, are enough to find roughly where an implant is."""
DENSITY_SIGMA = 0.3
"""Standard deviation of a density's logarithm before anything is measured."""
OUTLIER = 2.0
"""Residuals larger than this many times their scale count in proportion (Huber)."""
ALIKE_PX = 10.0
"""Pixels near one another that err alike, because of the background's error, count as one."""


class Behind(Protocol):
    """Line integrals of a scan that know how metal and what surrounds it attenuate together."""

    @property
    def measured(self) -> Singles:
        """-ln of the transmission, (views, rows, columns)."""
        ...

    @property
    def line_integrals(self) -> Singles:
        """The same, corrected as if there were no metal."""
        ...

    def without(self, view: int, rays: NDArray[np.intp], lengths: Floats) -> tuple[Floats, Floats]:
        """What is left of rays behind paths through implants.

        Args:
            view: its number.
            rays: flat indices of pixels.
            lengths: in each implant, (implants, rays), mm.

        Returns:
            Line integrals without the implants, (rays,), and their derivatives with each length,
            (implants, rays), 1/mm.
        """
        ...


Beam = Callable[[Singles], Behind]
"""Makes of a volume without metal, (z, y, x), what is ``Behind`` it."""


@dataclass(frozen=True, eq=False)
class OneEnergy:
    """The beam of one energy: attenuations add up, whatever the background.

    Attributes:
        measured: line integrals, (views, rows, columns).
        attenuations: of each implant, 1/mm.
    """

    measured: Singles
    attenuations: Floats

    @property
    def line_integrals(self) -> Singles:
        """Nothing to correct."""
        return self.measured

    def __call__(self, background: Singles) -> Behind:
        """The same for all."""
        return self

    def without(self, view: int, rays: NDArray[np.intp], lengths: Floats) -> tuple[Floats, Floats]:
        """See ``Behind``."""
        slopes = np.broadcast_to(-np.asarray(self.attenuations)[:, None], lengths.shape)
        return self.measured[view].flat[rays] + (slopes * lengths).sum(axis=0), slopes


@dataclass(frozen=True, eq=False)
class Implant:
    """A body, and where it is believed to be.

    Attributes:
        body: its shape.
        world_from_implant: its pose.
    """

    body: Body
    world_from_implant: Pose


@dataclass(frozen=True, eq=False)
class FoundImplant:
    """Where an implant is.

    Attributes:
        world_from_implant: its pose.
        covariance: of a twist (v, w) in its own axes, (6, 6), mm and rad; where nothing tells, such
            as of a rod's roll, what was allowed beforehand.
        density: factor on its attenuation that explains the line integrals, over what lies about
            it: 1 less the share of the background there.
        slack: by how much it seems to be displaced in each view beside that, in its own axes,
            (views, 3), mm.
    """

    world_from_implant: Pose
    covariance: Floats
    density: float
    slack: Floats


@dataclass(frozen=True, eq=False)
class WithoutImplants:
    """Line integrals as if what surrounds the implants filled their places, and the implants.

    Attributes:
        line_integrals: (views, rows, columns), float32.
        background: the last volume of them, (z, y, x), float32.
        found: the implants, in the order in which they were given.
    """

    line_integrals: Singles
    background: Singles
    found: tuple[FoundImplant, ...]


def without_implants(
    A: Projector,
    beam: Beam,
    implants: Sequence[Implant],
    background: ArrayLike,
    *,
    surroundings: Singles | None = None,
    position_sigma_mm: float = 2.0,
    rotation_sigma_deg: float = 5.0,
    slack_mm: float = 0.1,
    rounds: int = 1,
    iterations: int = 3,
    relaxation: float = 0.3,
    mask: ArrayLike | None = None,
    callback: Callback | None = None,
) -> WithoutImplants:
    """Find implants of known shape and material, and take them out (known components).

    In turns, as Stayman, Otake, Prince, Khanna and Siewerdsen (IEEE Trans Med Imaging 31, 2012) do:
    with the background held, the implants' poses and densities follow from the residuals about
    their shadows by Gauss-Newton steps, whose derivatives are exact (``twinct.shadow``); with these
    held, the background is reconstructed from line integrals without the implants, by ``sart``.
    Unlike theirs the background is not part of one objective function, so that any algorithm can go
    on with the line integrals afterwards.

    The steps go from coarse to fine: residual and derivatives are blurred by as much as the implant
    may be off, then by less. Believed poses of source and panel err in every view alone; an implant
    may therefore be displaced in each view a little, along the panel, as a random effect of
    standard deviation ``slack_mm`` that is eliminated from the normal equations of its pose.

    What the implants' places hold in the background cannot be told from their density: their
    shadows are taken out as far as they exceed it. Rays that hardly come through are set to what
    the background lets expect.

    Memory at its peak: 2 volumes and 3 times the projections, beside those given.

    Args:
        A: the projector, with the believed geometry.
        beam: makes of a background the line integrals behind it.
        implants: shapes, and poses to start from.
        background: a volume without metal to start from, (z, y, x), such as that of the line
            integrals of ``without_metal``.
        surroundings: line integrals of what lies around the grid, (views, rows, columns).
        position_sigma_mm: standard deviation of the believed position along each axis, mm.
        rotation_sigma_deg: the same about each axis of the implant, deg.
        slack_mm: see above; 0 for exact poses.
        rounds: of poses and background; the poses are gone over once more at the end.
        iterations: of each ``sart``.
        relaxation: of each ``sart``.
        mask: True where a pixel counts, (rows, columns) or (views, rows, columns), bool.
        callback: of each ``sart``.

    Raises:
        InputError: numbers out of range; an implant outside of the grid, or behind a source; a view
            whose every ray passes an implant; or as in ``sart``.
    """
    checks = Checks(A.range_shape)
    rounds = checks.count("rounds", rounds)
    for name, value in (
        ("position_sigma_mm", position_sigma_mm),
        ("rotation_sigma_deg", rotation_sigma_deg),
        ("slack_mm", slack_mm),
    ):
        checks.not_negative(name, value)
    checks.start(background, A.domain_shape)
    checks.problems += outside(A, implants)
    checks.done()
    refuse_if_short(
        implant_bytes(math.prod(A.domain_shape), math.prod(A.range_shape)),
        f"taking out implants on {A.domain_shape} voxels",
        advice(),
    )
    volume = np.asarray(background, dtype=np.float32)
    behind = beam(volume)
    _, pixels = checks.projections(behind.measured, mask)
    checks.done()
    allowed = np.repeat(np.maximum([position_sigma_mm, math.radians(rotation_sigma_deg)], 1e-5), 3)
    fit = _Fit(
        Rays(A.geometry), [_Sought(one, len(A)) for one in implants], allowed, slack_mm, pixels
    )
    for number in range(rounds):
        expected = A(volume)
        if surroundings is not None:
            expected += surroundings
        fit.go_on(behind, expected, coarse=number == 0)
        rest = fit.taken_out(behind, expected)
        inner = rest if surroundings is None else rest - surroundings
        volume = sart(
            A, inner, iterations=iterations, relaxation=relaxation, mask=pixels, callback=callback
        ).array
        behind = beam(volume)
    expected = A(volume) if surroundings is None else A(volume) + surroundings
    fit.go_on(behind, expected, coarse=False)
    found = tuple(one.found() for one in fit.sought)
    return WithoutImplants(fit.taken_out(behind, expected), volume, found)


def implant_bytes(voxels: int, pixels: int) -> int:
    """Bytes that ``without_implants`` takes beside what it is given; pixels of all views."""
    return 4 * (2 * voxels + 3 * pixels) + SPARE_BYTES


def outside(A: Projector, implants: Sequence[Implant], names: Sequence[str] = ()) -> list[str]:
    """What is wrong with where implants are believed to be, one sentence each.

    They must lie in the grid and in front of all sources, and leave some rays of each view.
    """
    problems: list[str] = []
    local, rays = A.grid.world_from_grid.inverse(), Rays(A.geometry)
    labels = names or [f"implant {i}" for i in range(len(implants))]
    for label, one in zip(labels, implants, strict=True):
        corners = (local @ one.world_from_implant).apply(one.body.vertices)
        beyond = (np.abs(corners) - A.grid.size_mm / 2).max()
        if beyond > 0:
            problems.append(f"{label} reaches {beyond:.1f} mm out of the grid: it must lie inside")
    if problems:
        return problems
    try:
        for view in range(len(A)):
            shaded = np.zeros(A.range_shape[1:], np.bool_)
            for one in implants:
                box, lengths, _ = rays.shadow(one.body, one.world_from_implant, view)
                shaded[box] |= lengths > 0
            if shaded.all():
                problems.append(f"every ray of view {view} passes an implant: nothing is left")
    except InputError as error:
        problems += error.problems
    return problems


class _Sought:
    """An implant whose pose is worked on."""

    def __init__(self, implant: Implant, views: int) -> None:
        self.body, self.start = implant.body, implant.world_from_implant
        self.pose, self.logarithm = self.start, 0.0
        self.slack = np.zeros((views, 3))
        self.information = np.eye(7)

    @property
    def density(self) -> float:
        return math.exp(self.logarithm)

    def at(self, view: int) -> Pose:
        """Where it seems to be in a view."""
        return self.pose @ Pose(self.slack[view], np.array([0.0, 0.0, 0.0, 1.0]))

    def found(self) -> FoundImplant:
        covariance: Any = np.linalg.inv(self.information)[:6, :6]
        return FoundImplant(self.pose, covariance, self.density, self.slack.copy())


@dataclass(frozen=True, eq=False)
class _Fit:
    """Poses of implants from residuals about their shadows.

    Attributes:
        rays: of the believed views.
        sought: the implants.
        allowed: standard deviations of a twist (v, w) from where they are believed, (6,).
        slack_mm: standard deviation of the displacement in each view.
        mask: where pixels count.
    """

    rays: Rays
    sought: list[_Sought]
    allowed: Floats
    slack_mm: float
    mask: Mask | None

    @property
    def geometry(self) -> ScanGeometry:
        """The believed views."""
        return self.rays.geometry

    def go_on(self, behind: Behind, expected: Singles, *, coarse: bool) -> None:
        """Improve all poses, from as coarse as they may be off if that is asked for."""
        for i, one in enumerate(self.sought):
            magnification = self.geometry.sdd / self.geometry.depth(one.start.position)
            pixels = float(magnification.mean()) / self.geometry.panel.pitch_u
            reach = (self.allowed[0] + self.allowed[3] * one.body.radius_mm) * pixels
            blurs = [reach / 2**n for n in range(8) if reach / 2**n > FINEST_PX] if coarse else []
            for blur in [*blurs, FINEST_PX]:
                self._descend(i, behind, expected, blur)

    def _descend(self, i: int, behind: Behind, expected: Singles, blur: float) -> None:
        """A few Gauss-Newton steps of one implant at one blur, px."""
        fine, views = blur <= FINEST_PX, len(self.geometry)
        some = range(0, views, 1 if fine else max(views // SOME_VIEWS, 1))
        enough = 1e-3 if fine else 0.02 * blur
        for _ in range(4):
            if self._step(i, behind, expected, blur, some, fine) < enough:
                break

    def _step(
        self, i: int, behind: Behind, expected: Singles, blur: float, views: range, fine: bool
    ) -> float:
        """One step, how long it was at the implant's ends, mm."""
        one, free = self.sought[i], 7 if fine else 6
        weight = np.diag([*(1 / self.allowed**2), 1 / DENSITY_SIGMA**2])
        off = np.array([*(one.start.inverse() @ one.pose).log(), one.logarithm])
        information, pull = weight.copy(), -weight @ off
        slack = self.slack_mm if fine else 0.0
        answers: list[tuple[int, Any, Any, Any, Any]] = []
        for view in views:
            rest, slopes = self._residual(i, view, behind, expected, blur)
            if not len(rest):
                continue
            scale = 1.4826 * float(np.median(np.abs(rest))) + 1e-9
            robust = np.minimum(1, OUTLIER * scale / np.maximum(np.abs(rest), 1e-12))
            robust /= scale**2 * max(4 * math.pi * blur**2, ALIKE_PX)
            normal = (slopes * robust[:, None]).T @ slopes
            pulled = -slopes.T @ (robust * rest)
            if slack:
                # The view's own displacement along the panel is eliminated (Schur complement).
                along = one.pose.inverse().rotate([self.geometry.u[view], self.geometry.v[view]])
                both = normal[:, :3] @ along.T
                own = np.linalg.inv(along @ both[:3] + np.eye(2) / slack**2)
                aside = along @ (pulled[:3] - one.slack[view] / slack**2)
                answers.append((view, along, own, aside, both))
                pulled = pulled - both @ own @ aside
                normal = normal - both @ own @ both.T
            information += normal
            pull += pulled
        step = np.zeros(7)
        step[:free] = np.linalg.solve(information[:free, :free], pull[:free])
        length = float(np.linalg.norm(step[:3]) + one.body.radius_mm * np.linalg.norm(step[3:6]))
        longest = max(float(self.allowed[0]), 0.5)
        step *= min(1, longest / max(length, 1e-12))
        for view, along, own, aside, both in answers:
            one.slack[view] += (own @ (aside - both.T @ step)) @ along
        one.pose = one.pose @ Pose.exp(step[:6])
        one.logarithm += float(step[6])
        one.information = information
        return length

    def _residual(
        self, i: int, view: int, behind: Behind, expected: Singles, blur: float
    ) -> tuple[Floats, Floats]:
        """Residuals about a shadow, (rays,), and their derivatives, (rays, 7), blurred."""
        one = self.sought[i]
        box = self.rays.box(one.body, one.at(view), view, 3 * blur + 2)
        if 0 in box.shape:
            return np.empty(0), np.empty((0, 7))
        rays, left, slopes = self._behind(behind, view, box)
        rest = (behind.line_integrals[view][box] - expected[view][box]).astype(np.float64)
        rest.flat[rays] = left - expected[view][box].flat[rays]
        _, lengths, turns = self.rays.shadow(one.body, one.at(view), view, slopes=True, box=box)
        jacobian = np.zeros((*box.shape, 7))
        by_length = np.zeros(box.shape)
        by_length.flat[rays] = slopes[i] * one.density
        steep = np.linalg.norm(turns[..., :3], axis=-1)
        jacobian[..., :6] = turns * np.minimum(1, STEEPEST / np.maximum(steep, 1e-12))[..., None]
        jacobian[..., 6] = lengths
        jacobian *= by_length[..., None]
        trust = _trust(behind.measured[view][box])
        if self.mask is not None:
            trust = np.where(mask_of(self.mask, view)[box], trust, 0.0)
            rest = np.where(trust > 0, rest, 0.0)
        rest *= trust
        jacobian *= trust[..., None]
        rest = scipy.ndimage.gaussian_filter(rest, blur)
        jacobian = scipy.ndimage.gaussian_filter(jacobian, (blur, blur, 0))
        told = np.abs(jacobian[..., :3]).sum(axis=-1) > 1e-4
        return rest[told], jacobian[told]

    def _behind(
        self, behind: Behind, view: int, box: Box
    ) -> tuple[NDArray[np.intp], Floats, Floats]:
        """Rays of a box through any implant, flat in it; what is left of them; derivatives."""
        lengths = np.stack(
            [
                one.density * self.rays.shadow(one.body, one.at(view), view, box=box).lengths
                for one in self.sought
            ]
        ).reshape(len(self.sought), -1)
        rays = np.flatnonzero((lengths > 0).any(axis=0))
        row, column = np.divmod(rays, box.shape[1])
        panel = (row + box.rows.start) * self.geometry.panel.columns + column + box.columns.start
        return rays, *behind.without(view, panel, lengths[:, rays])

    def taken_out(self, behind: Behind, expected: Singles) -> Singles:
        """Line integrals without the implants."""
        rest = behind.line_integrals.copy()
        rows, columns = self.geometry.panel.shape
        whole = Box(slice(0, rows), slice(0, columns))
        for view, image in enumerate(rest):
            rays, left, _ = self._behind(behind, view, whole)
            trust = _trust(behind.measured[view].flat[rays])
            image.flat[rays] = trust * left + (1 - trust) * expected[view].flat[rays]
        return rest


def _trust(measured: NDArray[Any]) -> Floats:
    """From 1 where rays are bright to 0 where noise is all that they hold."""
    return 1 / (1 + np.exp(np.asarray(measured, dtype=np.float64) - STARVED))
