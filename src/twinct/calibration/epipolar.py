"""Geometry from projections alone, without a volume: what two views both tell of a plane agrees.

A plane through the sources of two views cuts either panel in a line, and both lines tell the same
derivative of the specimen's plane integral (Debbeler et al., Fully3D 2013, 358; Aichert et al.,
IEEE Trans. Med. Imaging 34 (2015) 2205). Each view is moved until they do, over many planes of many
pairs, all views at once. The derivatives are summed once along all lines of each panel; moving
source or panel only changes which of these lines a plane asks for.

Where the specimen reaches beyond the panel, a line is cut and tells too little. Such lines count,
too: how far complete and cut lines disagree is seen from the scan, and each kind weighs by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinct.calibration.freedom import Freedom, PosePrior, What
from twinct.calibration.plane_integrals import PlaneIntegrals
from twinct.calibration.plane_pairs import PlanePairs, axes, baselines
from twinct.errors import CalibrationError, InputError
from twinct.geometry import Floats, ScanGeometry, VolumeGrid
from twinct.progress import SILENT, Progress
from twinct.recon.checks import Checks
from twinct.recon.resolution import binned

ACROSS = (50, 100, 200, 200)
"""Pixels along the panel's diagonal in each round; a panel of fewer stays as it is."""

ROBUST = 1.5
"""Differences above so many standard deviations pull with that of one there (Huber)."""

ALIKE = 30.0
"""Planes of a pair and pairs of a view see the same pixels: so many differences count as one."""

EMPTY = 0.02
"""Of what the thickest rays measure: where a complete line leaves the panel, less is measured."""

LEAST_TOLD = 0.05
"""Of the usual derivative: of a plane of which both views tell less, nothing is told."""

LEAST_PLANES = 50
"""Of a view: fewer do not tell where it is."""

LEAST_KIND = 200
"""Planes with complete, or with cut lines: of fewer the spread is not known, and all are one."""


@dataclass(frozen=True, eq=False)
class EpipolarConsistency:
    """What pairs of views say of a scan's geometry.

    Attributes:
        geometry: of all views.
        change: against what was believed, as in ``SelfCalibration``.
        residuals: spread of the differences between both views, before each round's step and after
            the last.
        planes: that tell something of each view, (views,).
        complete: those of them whose lines leave both panels beside the specimen, (views,).
        problems: of each view that tells too little: the prior holds it where it was believed.
    """

    geometry: ScanGeometry
    change: Floats
    residuals: tuple[float, ...]
    planes: NDArray[np.int64]
    complete: NDArray[np.int64]
    problems: dict[int, str]


def epipolar_consistent(
    line_integrals: NDArray[np.float32],
    believed: ScanGeometry,
    grid: VolumeGrid,
    prior: PosePrior,
    *,
    what: What = "arms",
    across: Sequence[int] = ACROSS,
    mask: NDArray[np.bool_] | None = None,
    progress: Progress = SILENT,
) -> EpipolarConsistency:
    """Move each view until it tells the same of planes as others do.

    Args:
        line_integrals: (views, rows, columns).
        believed: about where source and panel were.
        grid: about the specimen; only its middle plays a role.
        prior: what is known of the errors.
        what: may have moved; of a patient who does, the geometry found is relative to the patient.
        across: about how many pixels the panel's diagonal has in each round.
        mask: True where a pixel counts, (rows, columns) or (views, rows, columns).
        progress: hears of each round.

    Raises:
        InputError: arrays of other shapes, values that are not finite.
        CalibrationError: no view tells anything; what is missing.
    """
    checks = Checks((len(believed), *believed.panel.shape))
    p, pixels = checks.projections(line_integrals, mask)
    checks.done()
    if not across:
        raise InputError("across names no round")
    free = Freedom(what, grid.world_from_grid.position)
    change = np.zeros((len(believed), len(free.steps)))
    precision = prior.precision(len(believed), what)
    diagonal = float(np.hypot(*believed.panel.shape))
    residuals: list[float] = []

    def look(pixels_across: int) -> tuple[_Seen, int]:
        factor = max(round(diagonal / pixels_across), 1)
        geometry = free.all(believed, change).binned(factor, factor)
        coarse, counts = binned(p, pixels, (factor, factor))
        seen = _Seen.of(geometry, free.middle, PlaneIntegrals(coarse, geometry, counts))
        residuals.append(seen.spread)
        return seen, factor

    with progress.stage("epipolar consistency", len(across) + 1) as step:
        for pixels_across in across:
            seen, factor = look(pixels_across)
            tangents = _tangents(believed, free, change, factor)
            normal, right = seen.normal_equations(seen.weights(), tangents)
            pull = right - precision @ change.ravel()
            change = change + np.linalg.solve(precision + normal, pull).reshape(change.shape)
            step()
        seen, _ = look(across[-1])
        step()
    return EpipolarConsistency(
        free.all(believed, change),
        change,
        tuple(residuals),
        seen.per_view(seen.used),
        seen.per_view(seen.used & seen.complete),
        seen.problems(),
    )


def _tangents(believed: ScanGeometry, free: Freedom, change: Floats, factor: int) -> Floats:
    """How S, D, u and v of each view follow its numbers, (views, n, 4, 3)."""

    def vectors(at: Floats) -> Floats:
        view = free.all(believed, at).binned(factor, factor)
        return np.stack([view.source, view.detector, view.u, view.v], axis=1)

    return np.stack(
        [
            (vectors(change + one) - vectors(change - one)) / (2 * one.sum())
            for one in np.diag(free.steps)
        ],
        axis=1,
    )


@dataclass(frozen=True, eq=False)
class _Seen:
    """What both views of each pair tell of their planes.

    Attributes:
        geometry: of all views.
        pairs: and their planes.
        told: derivatives of plane integrals, (2, pairs, planes).
        by_line: how they change with the lines, (2, pairs, planes, 3).
        cut: planes that cut both panels where pixels count, (pairs, planes).
        used: those of which something is told.
        complete: those whose lines leave both panels beside the specimen.
    """

    geometry: ScanGeometry
    pairs: PlanePairs
    told: Floats
    by_line: Floats
    cut: NDArray[np.bool_]
    used: NDArray[np.bool_]
    complete: NDArray[np.bool_]

    @classmethod
    def of(cls, geometry: ScanGeometry, middle: Floats, integrals: PlaneIntegrals) -> _Seen:
        """Compare all pairs.

        Raises:
            CalibrationError: no view tells anything.
        """
        pairs = PlanePairs.of(geometry, middle)
        lines = pairs.lines(geometry)
        told, by_line = np.zeros(lines.shape[:-1]), np.zeros(lines.shape)
        left = np.zeros(told.shape)
        for view in range(len(geometry)):
            own = pairs.sides == view
            told[own], by_line[own], left[own] = integrals.at(view, lines[own])
        cut = np.asarray(np.isfinite(left).all(axis=0))
        most = np.abs(told).max(axis=0)
        usual = float(np.sqrt((most[cut] ** 2).mean())) if cut.any() else 0.0
        used = cut & (most > LEAST_TOLD * usual)
        complete = np.asarray(left.max(axis=0) < EMPTY)
        seen = cls(geometry, pairs, told, by_line, cut, used, complete)
        if len(problems := seen.problems()) == len(geometry):
            raise CalibrationError(
                f"no view tells where it is by planes of others; view 0: {problems[0]}"
            )
        return seen

    def per_view(self, planes: NDArray[np.bool_]) -> NDArray[np.int64]:
        """How many of these planes each view has a part in, (views,)."""
        each = np.broadcast_to(planes.sum(axis=1), self.pairs.sides.shape)
        views = len(self.geometry)
        return np.bincount(self.pairs.sides.ravel(), each.ravel(), views).astype(np.int64)

    def problems(self) -> dict[int, str]:
        """What each view lacks that tells too little."""
        partners, cut, used = (
            self.per_view(planes) for planes in (np.ones_like(self.cut), self.cut, self.used)
        )
        found: dict[int, str] = {}
        for view in np.flatnonzero(used < LEAST_PLANES):
            if not partners[view]:
                problem = "all sources that it is compared with are too near to its own"
            elif cut[view] < LEAST_PLANES:
                problem = (
                    f"{cut[view]} planes through its source and another's cut both panels where "
                    f"pixels count, {LEAST_PLANES} are needed"
                )
            else:
                problem = (
                    f"something is measured on {used[view]} of the {cut[view]} planes that it "
                    f"shares with others, {LEAST_PLANES} are needed"
                )
            found[int(view)] = problem
        return found

    @property
    def spread(self) -> float:
        """Of the differences between both views."""
        return _spread(self.told[0] - self.told[1], self.used)

    def weights(self) -> Floats:
        """Of each plane's difference, (pairs, planes)."""
        rest = self.told[0] - self.told[1]
        weight = np.zeros(rest.shape)
        kinds = [self.used & self.complete, self.used & ~self.complete]
        if min(np.count_nonzero(kind) for kind in kinds) < LEAST_KIND:
            kinds = [self.used]
        for kind in kinds:
            spread = max(_spread(rest, kind), 1e-9)
            pull = np.maximum(np.abs(rest[kind]) / (ROBUST * spread), 1.0)
            weight[kind] = 1 / (ALIKE * spread**2 * pull)
        return weight

    def normal_equations(self, weights: Floats, tangents: Floats) -> tuple[Floats, Floats]:
        """Of all views, (views * n, views * n) and (views * n,).

        Args:
            weights: of each plane, (pairs, planes).
            tangents: of S, D, u and v, (views, n, 4, 3).
        """
        sides, normals = self.pairs.sides, self.pairs.normals
        # A baseline b whose end moves by d turns a normal n by -b (n.d) / b^2, and no further.
        along = baselines(self.geometry, sides)
        by_normal = np.einsum("spnk,spkx->spnx", self.by_line, axes(self.geometry)[sides])
        turned = -np.einsum("pnx,px->pn", by_normal[0] - by_normal[1], along)
        turned /= (along**2).sum(axis=1)[:, None]
        rest = self.told[0] - self.told[1]
        views, size = tangents.shape[:2]
        normal, right = np.zeros((views, size, views, size)), np.zeros((views, size))
        for pair, ends in enumerate(sides.T):
            own = self.used[pair]
            slopes: list[Floats] = []
            for side, (view, sign) in enumerate(zip(ends, (1.0, -1.0), strict=True)):
                by_u, by_v, by_height = self.by_line[side, pair, own].T
                by_source = by_height - turned[pair, own]
                by_vector = sign * np.stack([by_source, -by_height, by_u, by_v], axis=1)
                moves = np.einsum("nx,kqx->nkq", normals[pair, own], tangents[view])
                slopes.append(np.einsum("nq,nkq->nk", by_vector, moves))
            for one, slope in zip(ends, slopes, strict=True):
                pulled = (slope * weights[pair, own, None]).T
                right[one] -= pulled @ rest[pair, own]
                for other, across in zip(ends, slopes, strict=True):
                    normal[one, :, other] += pulled @ across
        return normal.reshape(views * size, -1), right.ravel()


def _spread(rest: Floats, of: NDArray[np.bool_]) -> float:
    """Standard deviation, were they normal."""
    return 1.4826 * float(np.median(np.abs(rest[of])))
