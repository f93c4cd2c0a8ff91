"""Geometry from projections alone, without a volume: plane integrals of pairs of views agree.

A plane through the sources of two views cuts both panels in a line. Both lines give the same
derivative of the specimen's plane integral (Debbeler et al., Fully3D 2013, 358; Aichert et al.,
IEEE Trans. Med. Imaging 34 (2015) 2205). All views are moved together until they agree on many
planes of many pairs. The derivatives are computed once for all lines of each panel; moving the
source or the panel only changes the lines that a plane needs.

If the specimen extends beyond the panel, lines are truncated and give too little. Truncated lines
count as well: the scan shows the disagreement of complete and of truncated lines, and each kind is
weighted by its own spread.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinct.calibration.freedom import Freedom, PosePrior, What
from twinct.calibration.plane_integrals import PlaneIntegrals
from twinct.calibration.plane_pairs import PlanePairs, axes, baselines
from twinct.core.errors import CalibrationError, InputError
from twinct.core.progress import SILENT, Progress
from twinct.geometry import Floats, ScanGeometry, VolumeGrid
from twinct.recon.checks import Checks
from twinct.recon.resolution import binned

ACROSS = (50, 100, 200, 200)
"""Pixels along the panel's diagonal in each round; a panel with fewer is not binned."""

ROBUST = 1.5
"""Differences above so many standard deviations pull like one at this threshold (Huber)."""

ALIKE = 30.0
"""Number of differences that count as one, as planes of a pair and pairs of a view share pixels."""

EMPTY = 0.02
"""Largest line integral at the ends of a complete line, relative to the thickest rays."""

LEAST_TOLD = 0.05
"""Minimum derivative of a usable plane in at least one view, relative to the usual one."""

LEAST_PLANES = 50
"""Minimum number of usable planes that determine a view."""

LEAST_KIND = 200
"""Minimum number of planes of each kind, complete or truncated, to weight both separately."""


@dataclass(frozen=True, eq=False)
class EpipolarConsistency:
    """Geometry of a scan, estimated from pairs of views.

    Attributes:
        geometry: geometry of all views.
        change: change from the believed geometry, as in ``SelfCalibration``.
        residuals: spread of the differences between paired views, before each round's update and
            after the last.
        planes: number of usable planes of each view, (views,).
        complete: number of these planes whose lines leave both panels beside the specimen,
            (views,).
        problems: reason for each view with too few usable planes; the prior holds it where it was
            believed.
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
    """Move each view until its plane integrals agree with the other views.

    Args:
        line_integrals: (views, rows, columns).
        believed: approximate geometry.
        grid: grid around the specimen; only its middle matters.
        prior: prior on the errors.
        what: moving part; for a patient, the resulting geometry is relative to the patient.
        across: approximate number of pixels along the panel's diagonal in each round.
        mask: True where a pixel counts, (rows, columns) or (views, rows, columns).
        progress: receives a step for each round.

    Raises:
        InputError: arrays have other shapes or values that are not finite, or ``across`` is empty.
        CalibrationError: no view has enough usable planes.
    """
    p, pixels = _checked(line_integrals, believed, mask, across)
    free = Freedom(what, grid.world_from_grid.position)
    change = np.zeros((len(believed), len(free.steps)))
    precision = prior.precision(len(believed), what)
    diagonal = float(np.hypot(*believed.panel.shape))
    residuals: list[float] = []

    def look(pixels_across: int) -> tuple[PlaneDerivatives, int]:
        factor = max(round(diagonal / pixels_across), 1)
        geometry = free.all(believed, change).binned(factor, factor)
        coarse, counts = binned(p, pixels, (factor, factor))
        seen = PlaneDerivatives.of(geometry, free.middle, PlaneIntegrals(coarse, geometry, counts))
        residuals.append(seen.spread)
        return seen, factor

    with progress.stage("epipolar consistency", len(across) + 1) as step:
        for pixels_across in across:
            seen, factor = look(pixels_across)
            tangents = free.tangents(believed, change, factor)
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


def _checked(
    line_integrals: NDArray[np.float32],
    believed: ScanGeometry,
    mask: NDArray[np.bool_] | None,
    across: Sequence[int],
) -> tuple[NDArray[np.float32], NDArray[np.bool_] | None]:
    checks = Checks((len(believed), *believed.panel.shape))
    p, pixels = checks.projections(line_integrals, mask)
    checks.done()
    if not across:
        raise InputError("across is empty; it must name at least one round")
    return p, pixels


@dataclass(frozen=True, eq=False)
class PlaneDerivatives:
    """Derivatives of plane integrals in both views of each pair.

    Attributes:
        geometry: geometry of all views.
        pairs: pairs of views and their planes.
        values: derivatives of plane integrals, (2, pairs, planes).
        by_line: derivatives of ``values`` by the lines, (2, pairs, planes, 3).
        cut: planes that cut both panels where pixels count, (pairs, planes).
        used: usable planes, (pairs, planes).
        complete: planes whose lines leave both panels beside the specimen, (pairs, planes).
    """

    geometry: ScanGeometry
    pairs: PlanePairs
    values: Floats
    by_line: Floats
    cut: NDArray[np.bool_]
    used: NDArray[np.bool_]
    complete: NDArray[np.bool_]

    @classmethod
    def of(
        cls, geometry: ScanGeometry, middle: Floats, integrals: PlaneIntegrals
    ) -> PlaneDerivatives:
        """Compare all pairs of views.

        Raises:
            CalibrationError: no view has enough usable planes.
        """
        pairs = PlanePairs.of(geometry, middle)
        lines = pairs.lines(geometry)
        values, by_line = np.zeros(lines.shape[:-1]), np.zeros(lines.shape)
        left = np.zeros(values.shape)
        for view in range(len(geometry)):
            own = pairs.sides == view
            values[own], by_line[own], left[own] = integrals.at(view, lines[own])
        cut = np.asarray(np.isfinite(left).all(axis=0))
        most = np.abs(values).max(axis=0)
        usual = float(np.sqrt((most[cut] ** 2).mean())) if cut.any() else 0.0
        used = cut & (most > LEAST_TOLD * usual)
        complete = np.asarray(left.max(axis=0) < EMPTY)
        seen = cls(geometry, pairs, values, by_line, cut, used, complete)
        if len(problems := seen.problems()) == len(geometry):
            raise CalibrationError(
                f"no view shares enough planes with others; view 0: {problems[0]}"
            )
        return seen

    def per_view(self, planes: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Return the number of the given planes that each view takes part in, (views,)."""
        each = np.broadcast_to(planes.sum(axis=1), self.pairs.sides.shape)
        views = len(self.geometry)
        return np.bincount(self.pairs.sides.ravel(), each.ravel(), views).astype(np.int64)

    def problems(self) -> dict[int, str]:
        """Return the problem of each view with too few usable planes."""
        partners, cut, used = (
            self.per_view(planes) for planes in (np.ones_like(self.cut), self.cut, self.used)
        )
        by_view: dict[int, str] = {}
        for view in np.flatnonzero(used < LEAST_PLANES):
            if not partners[view]:
                problem = "its source is too near to all sources that it is compared with"
            elif cut[view] < LEAST_PLANES:
                problem = (
                    f"{cut[view]} planes through its source and another cut both panels where "
                    f"pixels count, but {LEAST_PLANES} are needed"
                )
            else:
                problem = (
                    f"{used[view]} of the {cut[view]} planes that it shares with others carry a "
                    f"signal, but {LEAST_PLANES} are needed"
                )
            by_view[int(view)] = problem
        return by_view

    @property
    def spread(self) -> float:
        """Spread of the differences between paired views."""
        return _spread(self.values[0] - self.values[1], self.used)

    def weights(self) -> Floats:
        """Return the weight of each plane's difference, (pairs, planes)."""
        rest = self.values[0] - self.values[1]
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
        """Return the normal matrix, (views * n, views * n), and the right side, (views * n,).

        Args:
            weights: weight of each plane, (pairs, planes).
            tangents: derivatives of S, D, u and v, (views, n, 4, 3).
        """
        rest = self.values[0] - self.values[1]
        views, size = tangents.shape[:2]
        normal, right = np.zeros((views, size, views, size)), np.zeros((views, size))
        for pair, slopes in enumerate(self._slopes(tangents)):
            own, ends = self.used[pair], self.pairs.sides[:, pair]
            for one, slope in zip(ends, slopes, strict=True):
                pulled = (slope * weights[pair, own, None]).T
                right[one] -= pulled @ rest[pair, own]
                for other, across in zip(ends, slopes, strict=True):
                    normal[one, :, other] += pulled @ across
        return normal.reshape(views * size, -1), right.ravel()

    def shared_equations(self, weights: Floats, tangents: Floats) -> tuple[Floats, Floats]:
        """Return the normal matrix, (n, n), and the right side, (n,), of numbers of all views.

        Args:
            weights: weight of each plane, (pairs, planes).
            tangents: derivatives of S, D, u and v of each view by numbers of all views.
        """
        rest, size = self.values[0] - self.values[1], tangents.shape[1]
        normal, right = np.zeros((size, size)), np.zeros(size)
        for pair, (first, second) in enumerate(self._slopes(tangents)):
            own, slope = self.used[pair], first + second
            pulled = (slope * weights[pair, own, None]).T
            normal += pulled @ slope
            right -= pulled @ rest[pair, own]
        return normal, right

    def shared_pulls(self, weights: Floats, tangents: Floats) -> Floats:
        """Return the part of each pair in the right side of ``shared_equations``, (pairs, n)."""
        rest = self.values[0] - self.values[1]
        return np.array(
            [
                -((first + second).T * weights[pair, self.used[pair]]) @ rest[pair, self.used[pair]]
                for pair, (first, second) in enumerate(self._slopes(tangents))
            ]
        )

    def _slopes(self, tangents: Floats) -> Iterator[list[Floats]]:
        """Yield the slopes of each pair's differences by both views' numbers, (used planes, n)."""
        sides, normals = self.pairs.sides, self.pairs.normals
        # If the end of a baseline b moves by d, a normal n turns by -b (n.d) / b^2 and no further.
        along = baselines(self.geometry, sides)
        by_normal = np.einsum("spnk,spkx->spnx", self.by_line, axes(self.geometry)[sides])
        turned = -np.einsum("pnx,px->pn", by_normal[0] - by_normal[1], along)
        turned /= (along**2).sum(axis=1)[:, None]
        for pair, ends in enumerate(sides.T):
            own = self.used[pair]
            slopes: list[Floats] = []
            for side, (view, sign) in enumerate(zip(ends, (1.0, -1.0), strict=True)):
                by_u, by_v, by_height = self.by_line[side, pair, own].T
                by_source = by_height - turned[pair, own]
                by_vector = sign * np.stack([by_source, -by_height, by_u, by_v], axis=1)
                moves = np.einsum("nx,kqx->nkq", normals[pair, own], tangents[view])
                slopes.append(np.einsum("nq,nkq->nk", by_vector, moves))
            yield slopes


def _spread(rest: Floats, of: NDArray[np.bool_]) -> float:
    """Return the standard deviation by the median, assuming normal residuals."""
    return 1.4826 * float(np.median(np.abs(rest[of])))
