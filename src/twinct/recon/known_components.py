"""Implants of known shape: pose estimation from projections, and removal from line integrals.

Two steps alternate, as in Stayman, Otake, Prince, Khanna and Siewerdsen (IEEE Trans Med Imaging 31,
2012). With the background fixed, Gauss-Newton steps with exact derivatives
(``twinct.rays``) estimate the implants' poses and densities from the residuals about their
shadows. With the implants fixed, ``sart`` reconstructs the background from line integrals without
the implants. Unlike in the paper, the background is not part of one objective function, so that any
algorithm can continue with the line integrals afterwards.

The steps go from coarse to fine: residuals and derivatives are blurred by the possible error of the
implant's position, then by less. The believed poses of source and panel have independent errors in
every view. An implant may therefore be displaced a little along the panel in each view, as a random
effect of standard deviation ``slack_mm`` that is eliminated from the normal equations of its pose.

The background in the implants' place cannot be separated from their density: shadows are removed as
far as they exceed the background. Rays with hardly any transmission are set to the values expected
from the background.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from twinct.core.errors import InputError
from twinct.geometry import Floats, Pose, ScanGeometry
from twinct.rays import Body, PixelRectangle, Rays
from twinct.recon.checks import Checks, Mask, mask_of
from twinct.recon.engine import Singles
from twinct.recon.memory import SPARE_BYTES, advice, refuse_if_short
from twinct.recon.projector import Projector
from twinct.recon.sart import sart
from twinct.recon.steps import Callback

STARVED = 7.0
"""Line integral above which a ray through metal is less reliable than its expected value.

At 1e5 photons a pixel, 90 of them are left.
"""
FINEST_PX = 0.7
"""Smallest blur of residuals and derivatives, in pixels, since shadows have steep edges."""
STEEPEST = 10.0
"""Largest derivative of a path length by the body's position, mm per mm; unbounded at an edge."""
SOME_VIEWS = 50
"""Number of evenly spread views that suffice for a rough pose of an implant."""
DENSITY_SIGMA = 0.3
"""Standard deviation of a density's logarithm before any measurement."""
OUTLIER = 2.0
"""Multiple of their scale beyond which residuals count in proportion to their size (Huber)."""
ALIKE_PX = 10.0
"""Number of neighbouring pixels that count as one, since they share the background's error."""


class Behind(Protocol):
    """Line integrals of a scan, with the joint attenuation of metal and its surroundings."""

    @property
    def measured(self) -> Singles:
        """Negative logarithm of the transmission, (views, rows, columns)."""
        ...

    @property
    def line_integrals(self) -> Singles:
        """Line integrals corrected as if there were no metal, (views, rows, columns)."""
        ...

    def without(self, view: int, rays: NDArray[np.intp], lengths: Floats) -> tuple[Floats, Floats]:
        """Return the line integrals of rays without the implants, and their derivatives.

        Args:
            view: number of the view.
            rays: flat indices of pixels.
            lengths: path lengths in each implant, (implants, rays), mm.

        Returns:
            Line integrals without the implants, (rays,), and their derivatives by each path length,
            (implants, rays), 1/mm.
        """
        ...


Beam = Callable[[Singles], Behind]
"""Function from a volume without metal, (z, y, x), to the line integrals ``Behind`` it."""


@dataclass(frozen=True, eq=False)
class OneEnergy:
    """Beam of one energy: attenuations add up, regardless of the background.

    Attributes:
        measured: line integrals, (views, rows, columns).
        attenuations: attenuation of each implant, 1/mm.
    """

    measured: Singles
    attenuations: Floats

    @property
    def line_integrals(self) -> Singles:
        """Line integrals as measured, which need no correction."""
        return self.measured

    def __call__(self, background: Singles) -> Behind:
        """Return the beam itself, whatever the background."""
        return self

    def without(self, view: int, rays: NDArray[np.intp], lengths: Floats) -> tuple[Floats, Floats]:
        """Return the line integrals without the implants; see ``Behind``."""
        slopes = np.broadcast_to(-np.asarray(self.attenuations)[:, None], lengths.shape)
        return self.measured[view].flat[rays] + (slopes * lengths).sum(axis=0), slopes


@dataclass(frozen=True, eq=False)
class BelievedImplant:
    """Body with its believed pose.

    Attributes:
        body: shape of the implant.
        world_from_implant: pose of the implant.
    """

    body: Body
    world_from_implant: Pose


@dataclass(frozen=True, eq=False)
class FittedImplant:
    """Estimated pose and density of an implant.

    Attributes:
        world_from_implant: pose of the implant.
        covariance: covariance of a twist (v, w) in its own axes, (6, 6), mm and rad; the a-priori
            covariance where the scan holds no information, such as on a rod's roll.
        density: factor on the attenuation that explains the line integrals, in excess of the
            surroundings: 1 less the share of the background there.
        slack: additional apparent displacement in each view, in its own axes, (views, 3), mm.
    """

    world_from_implant: Pose
    covariance: Floats
    density: float
    slack: Floats


@dataclass(frozen=True, eq=False)
class WithoutImplants:
    """Line integrals with the implants replaced by their surroundings, and the implants.

    Attributes:
        line_integrals: (views, rows, columns), float32.
        background: last volume without the implants, (z, y, x), float32.
        fitted: estimated implants, in the given order.
    """

    line_integrals: Singles
    background: Singles
    fitted: tuple[FittedImplant, ...]


def without_implants(
    A: Projector,
    beam: Beam,
    implants: Sequence[BelievedImplant],
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
    """Find implants of known shape and material, and remove them (known components).

    Peak memory: 2 volumes and 3 times the projections, besides the input.

    Args:
        A: the projector, with the believed geometry.
        beam: function from a background to the line integrals behind it.
        implants: shapes and initial poses.
        background: initial volume without metal, (z, y, x), such as from the line integrals of
            ``without_metal``.
        surroundings: line integrals of the grid's surroundings, (views, rows, columns).
        position_sigma_mm: standard deviation of the believed position along each axis, mm.
        rotation_sigma_deg: standard deviation of the believed rotation about each axis of the
            implant, deg.
        slack_mm: standard deviation of the displacement in each view; 0 for exact poses.
        rounds: rounds of poses and background; the poses are refined once more at the end.
        iterations: iterations of each ``sart``.
        relaxation: relaxation of each ``sart``.
        mask: True where a pixel counts, (rows, columns) or (views, rows, columns), bool.
        callback: callback of each ``sart``.

    Raises:
        InputError: a number is out of range, an implant is outside the grid or behind a source,
            every ray of a view passes an implant, or as in ``sart``.
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
        f"removing implants on a grid of {A.domain_shape} voxels",
        advice(),
    )
    volume = np.asarray(background, dtype=np.float32)
    behind = beam(volume)
    _, pixels = checks.projections(behind.measured, mask)
    checks.done()
    allowed = np.repeat(np.maximum([position_sigma_mm, math.radians(rotation_sigma_deg)], 1e-5), 3)
    fit = _PoseEstimation(
        Rays(A.geometry), [_ImplantFit(one, len(A)) for one in implants], allowed, slack_mm, pixels
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
    fitted = tuple(one.fitted() for one in fit.sought)
    return WithoutImplants(fit.taken_out(behind, expected), volume, fitted)


def implant_bytes(voxels: int, pixels: int) -> int:
    """Return the bytes that ``without_implants`` needs besides its input; pixels of all views."""
    return 4 * (2 * voxels + 3 * pixels) + SPARE_BYTES


def outside(
    A: Projector, implants: Sequence[BelievedImplant], names: Sequence[str] = ()
) -> list[str]:
    """Return one sentence for each problem with the believed poses of implants.

    Implants must lie in the grid and in front of all sources, and leave some rays of each view.
    """
    problems: list[str] = []
    local, rays = A.grid.world_from_grid.inverse(), Rays(A.geometry)
    labels = names or [f"implant {i}" for i in range(len(implants))]
    for label, one in zip(labels, implants, strict=True):
        corners = (local @ one.world_from_implant).apply(one.body.vertices)
        beyond = (np.abs(corners) - A.grid.size_mm / 2).max()
        if beyond > 0:
            problems.append(f"{label} extends {beyond:.1f} mm beyond the grid; it must lie inside")
    if problems:
        return problems
    try:
        for view in range(len(A)):
            shaded = np.zeros(A.range_shape[1:], np.bool_)
            for one in implants:
                box, lengths, _ = rays.shadow(one.body, one.world_from_implant, view)
                shaded[box] |= lengths > 0
            if shaded.all():
                problems.append(
                    f"every ray of view {view} passes through an implant, so nothing is left"
                )
    except InputError as error:
        problems += error.problems
    return problems


class _ImplantFit:
    """Implant whose pose is being estimated."""

    def __init__(self, implant: BelievedImplant, views: int) -> None:
        self.body, self.start = implant.body, implant.world_from_implant
        self.pose, self.logarithm = self.start, 0.0
        self.slack = np.zeros((views, 3))
        self.information = np.eye(7)

    @property
    def density(self) -> float:
        return math.exp(self.logarithm)

    def at(self, view: int) -> Pose:
        """Return the apparent pose in a view."""
        return self.pose @ Pose(self.slack[view], np.array([0.0, 0.0, 0.0, 1.0]))

    def fitted(self) -> FittedImplant:
        covariance: Any = np.linalg.inv(self.information)[:6, :6]
        return FittedImplant(self.pose, covariance, self.density, self.slack.copy())


@dataclass(frozen=True, eq=False)
class _PoseEstimation:
    """Estimation of implant poses from residuals about their shadows.

    Attributes:
        rays: rays of the believed views.
        sought: the implants.
        allowed: standard deviations of a twist (v, w) from the believed poses, (6,).
        slack_mm: standard deviation of the displacement in each view.
        mask: True where pixels count.
    """

    rays: Rays
    sought: list[_ImplantFit]
    allowed: Floats
    slack_mm: float
    mask: Mask | None

    @property
    def geometry(self) -> ScanGeometry:
        """The believed views."""
        return self.rays.geometry

    def go_on(self, behind: Behind, expected: Singles, *, coarse: bool) -> None:
        """Improve all poses; if ``coarse``, start with a blur as large as their possible error."""
        for i, one in enumerate(self.sought):
            magnification = self.geometry.sdd / self.geometry.depth(one.start.position)
            pixels = float(magnification.mean()) / self.geometry.panel.pitch_u
            reach = (self.allowed[0] + self.allowed[3] * one.body.radius_mm) * pixels
            blurs = [reach / 2**n for n in range(8) if reach / 2**n > FINEST_PX] if coarse else []
            for blur in [*blurs, FINEST_PX]:
                self._descend(i, behind, expected, blur)

    def _descend(self, i: int, behind: Behind, expected: Singles, blur: float) -> None:
        """Take a few Gauss-Newton steps for one implant at one blur, px."""
        fine, views = blur <= FINEST_PX, len(self.geometry)
        some = range(0, views, 1 if fine else max(views // SOME_VIEWS, 1))
        enough = 1e-3 if fine else 0.02 * blur
        for _ in range(4):
            if self._step(i, behind, expected, blur, some, fine) < enough:
                break

    def _step(
        self, i: int, behind: Behind, expected: Singles, blur: float, views: range, fine: bool
    ) -> float:
        """Take one step, and return its length at the implant's ends, mm."""
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
                # Eliminate the view's own displacement along the panel (Schur complement).
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
        """Return blurred residuals about a shadow, (rays,), and their derivatives, (rays, 7)."""
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
        sensitive = np.abs(jacobian[..., :3]).sum(axis=-1) > 1e-4
        return rest[sensitive], jacobian[sensitive]

    def _behind(
        self, behind: Behind, view: int, box: PixelRectangle
    ) -> tuple[NDArray[np.intp], Floats, Floats]:
        """Return the rays of a box through any implant, their line integrals, and derivatives.

        The rays are flat indices into the box.
        """
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
        """Return the line integrals without the implants."""
        rest = behind.line_integrals.copy()
        rows, columns = self.geometry.panel.shape
        whole = PixelRectangle(slice(0, rows), slice(0, columns))
        for view, image in enumerate(rest):
            rays, left, _ = self._behind(behind, view, whole)
            trust = _trust(behind.measured[view].flat[rays])
            image.flat[rays] = trust * left + (1 - trust) * expected[view].flat[rays]
        return rest


def _trust(measured: NDArray[Any]) -> Floats:
    """Return weights from 1 for bright rays to 0 for rays that hold only noise."""
    return 1 / (1 + np.exp(np.asarray(measured, dtype=np.float64) - STARVED))
