"""FISTA (Beck, Teboulle 2009): its update, its proximal step, and a solver with exact adjoints.

``Descent`` and ``Variation`` serve all regularised algorithms; ``fast`` takes its gradients from
the voxel-driven back projection (``ordered_subsets``), ``minimised`` from the exact adjoint.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from twinct.recon.checks import Mask, counting_rays, remainder
from twinct.recon.engine import Singles
from twinct.recon.order import subsets_of
from twinct.recon.projector import Projector
from twinct.recon.steps import Callback, Listener, sum_of_squares
from twinct.recon.volume import Volume
from twinct.recon.working import WorkingVolume

LEAST_WEIGHT = 0.05
"""Smallest curvature of a voxel, as a share of the mean; larger values make smaller, safe steps."""

DUAL_STEP = 1.8
"""Step size of the dual iteration, which no longer converges at 2."""

LOOSE = 2.0
"""Smallest ratio of Huber's bound to the mean residual of a view, in the first half of iterations.

With a tighter bound, a start far from the solution would need as many iterations again.
"""


@dataclass(frozen=True, eq=False)
class KnownBefore:
    """Expected values of a volume.

    Attributes:
        array: (z, y, x), 0 where nothing is known.
        inside: True where values are known, (z, y, x).
        share: share of the total variation that applies to the difference from ``array``, 0 to 1.
        closeness: weight of the squared difference of a voxel, relative to the mean curvature of
            the data term.
        far: difference beyond which it counts linearly instead (Huber's loss).
    """

    array: Singles
    inside: Mask
    share: float
    closeness: float = 0.0
    far: float = math.inf

    @cached_property
    def seams(self) -> NDArray[np.uint8]:
        """1 in voxels whose next neighbour is on the other side of the border, (z, y, x).

        Differences across the border of the known region mean nothing.
        """
        seam = np.zeros_like(self.inside)
        for axis in range(3):
            along, border = (np.moveaxis(mask, axis, 0) for mask in (self.inside, seam))
            border[:-1] |= along[1:] != along[:-1]
        return seam.view(np.uint8)

    def draw(self, z: Singles, b: Singles, curvature: Singles) -> None:
        """Add the pull towards the expected values to ``b`` and to the curvature.

        Huber's loss is below a square that touches it at ``z`` (Huber and Dutter 1974).
        """
        planes = zip(z, b, curvature, self.array, self.inside, strict=True)
        for here, drawn, own, there, known in planes:
            away = np.maximum(np.abs(here - there), np.float32(np.finfo(np.float32).tiny))
            weight = np.float32(self.closeness) * known
            weight *= np.minimum(np.float32(self.far) / away, np.float32(1))
            drawn += weight * there
            own += weight


_NOTHING = np.zeros((0, 0, 0), np.float32)
_NOWHERE = np.zeros((0, 0, 0), np.uint8)


@dataclass(eq=False)
class Variation:
    """Term strength * TV(x), or shares for x and for x less its expected values; x >= floor.

    Expected values may also draw single voxels to them.

    The proximal step solves the dual problem (Chambolle 2004) in the metric of the data term, from
    the dual of the previous step. Two terms have a dual each, and steps of half the size.
    """

    A: Projector
    strength: float
    steps: int
    floor: np.float32
    known: KnownBefore | None = None

    def __post_init__(self) -> None:
        """Set the duals to zero, where the kernels work."""
        duals, kernels, known = (1 if self.known is None else 2), self.A.kernels, self.known
        # Pages that stay zero take no memory.
        self._dual: Any = kernels.hold(np.zeros((3 * duals, *self.A.domain_shape), np.int16))
        self._expected = kernels.hold(_NOTHING if known is None else known.array)
        self._seams = kernels.hold(_NOWHERE if known is None else known.seams)

    def lower(self, b: Any, curvature: Any, x: Any, share: float = 0.0) -> None:
        """Write the minimiser of 0.5 |x - z|^2 in that metric plus this term to ``x``.

        Args:
            b: curvature times z, (z, y, x), or held by the kernels; it gets x plus ``share`` times
                the change of x.
            curvature: the metric, as the kernels' weights (``engine.Kernels.weigh``).
            x: the volume before, and after.
            share: that of the momentum.
        """
        kernels, inverse, known = self.A.kernels, 1.0 / self.A.grid.voxel, self.known
        shares = (1.0,) if known is None else (1 - known.share, known.share)
        radii, step = self.strength * np.array(shares), DUAL_STEP / len(shares)
        blocks, dual, others = self.A.blocks, self._dual, (self._expected, self._seams)
        for _ in range(self.steps if self.strength > 0 else 0):
            kernels.ascend(b, curvature, dual, radii, *others, inverse, self.floor, step, blocks)
        kernels.settle(b, curvature, dual, radii, inverse, self.floor, np.float32(share), x, blocks)


class Descent:
    """Volume on its way to the minimum of a data term and a variation: FISTA's updates."""

    def __init__(self, x: Singles, curvature: Singles, variation: Variation) -> None:
        """Start from a volume, which is overwritten.

        Args:
            x: the volume, (z, y, x).
            curvature: weights of the voxels, see ``engine.Kernels.weigh``.
            variation: the other term, with the floor.
        """
        self.variation, self._kernels = variation, variation.A.kernels
        self._curvature, self._weights = curvature, self._kernels.hold(curvature)
        self.start(x)

    def start(self, x: Singles) -> None:
        """Go on from a volume, which is overwritten, without momentum."""
        self._z: Any = None  # frees it
        self._work, self._z = WorkingVolume(self._kernels, x), self._kernels.hold(x.copy())
        self._momentum = 1.0

    @property
    def x(self) -> Singles:
        """The volume, (z, y, x)."""
        return self._work.array

    @property
    def held(self) -> Any:
        """The volume with momentum, at which the data term's gradient is taken, for the kernels."""
        return self._z

    def weighted(self) -> Any:
        """Multiply the volume with momentum by the curvature, and return it: a step adds to it."""
        self._kernels.weigh(self._z, self._weights)
        return self._z

    def settle(self) -> None:
        """Lower the variation of what ``weighted`` returned, with the steps added to it."""
        before = self._momentum
        self._momentum = (1 + math.sqrt(1 + 4 * before**2)) / 2
        share = (before - 1) / self._momentum
        self.variation.lower(self._z, self._weights, self._work.held, share)
        self._work.changed()

    def update(self, step: Singles) -> None:
        """Move by a step, the negative gradient, which is overwritten."""
        known, z = self.variation.known, self.z
        if known and known.closeness > 0:
            curvature = self._curvature.copy()
            known.draw(z, step, curvature)
            self._weights = self._kernels.hold(curvature)
        for here, change, own in zip(z, step, self._curvature, strict=True):
            change += own * here
        self._z = self._kernels.hold(step)
        self.settle()

    @property
    def z(self) -> Singles:
        """The volume with momentum, (z, y, x)."""
        held: Any = self._z
        if isinstance(held, np.ndarray):
            return cast(Singles, held)
        out = np.empty_like(self._work.array)
        self._kernels.bring(held, out)
        return out


def minimised(
    A: Projector,
    p: NDArray[Any],
    x: Singles,
    variation: Variation,
    *,
    iterations: int,
    rounds: int = 1,
    subsets: int,
    weights: NDArray[Any] | None = None,
    huber: float | None = None,
    mask: Mask | None = None,
    callback: Callback | None = None,
) -> Volume:
    """Minimise 0.5 |A x - p|_W^2 / d plus a variation, x >= floor, from a volume.

    d is the mean over the grid of A^T W A 1 per mm^3. The strength of the variation is then a pure
    number that means the same for any number of views, pixels or voxels. The step of each voxel is
    the inverse of the row sums of A^T W A, the largest over the subsets (a separable quadratic
    surrogate); momentum continues from subset to subset (Kim, Ramani, Fessler 2015). With one
    subset the objective converges to its minimum; with more, the volume comes near the minimum much
    sooner and then moves about it.

    With ``huber`` a residual beyond this bound counts by its size: 2 huber |r| - huber^2 (Huber
    1964) replaces its square, and is bounded by the same surrogate. In the first half of the
    iterations the bound is at least twice the mean residual of a view.

    With ``rounds`` the iterations are split into as many parts; after each part, p - A x is added
    to p (Osher et al., Multiscale Model. Simul. 4 (2005) 460), which brings back contrast that the
    variation lowered.

    Args:
        A: the projector.
        p: line integrals, (views, rows, columns).
        x: volume to start from, (z, y, x), which is overwritten.
        variation: the other term, with the floor.
        iterations: passes over all views.
        rounds: from 1 to the number of iterations.
        subsets: from 1 to the number of views.
        weights: W, (views, rows, columns); by default 1.
        huber: the bound.
        mask: as in ``sart``.
        callback: called after each update. True stops.
    """
    parts = [(A[views], views) for views in subsets_of(A.geometry, subsets)]
    trust = _trust(A, weights, mask)
    curvature, mean = _curvature(parts, trust)
    descent = Descent(x, curvature, variation)
    del x
    listener = Listener(callback, subsets)
    turns = {turn * iterations // rounds for turn in range(1, rounds)}
    measured, p = p, p.copy() if turns else p
    for iteration in range(iterations):
        if iteration in turns:
            for part, views in parts:
                rest = remainder(part, descent.x, measured, views, mask)
                for here, view in enumerate(views):
                    p[view] += rest[here]
                del rest
            descent.start(descent.x)
        early = iteration < iterations // 2
        for update, (part, views) in enumerate(parts):
            rest = remainder(part, descent.z, p, views, mask)
            square, rays = _total(rest, trust, views) if listener.wanted else (0.0, 0)
            for here, view in enumerate(views):
                if huber is not None:
                    bound = max(huber, LOOSE * float(np.abs(rest[here]).mean()) * early)
                    np.clip(rest[here], -bound, bound, out=rest[here])
                rest[here] *= trust[view]
            step = part.T(rest)
            del rest
            step *= np.float32(subsets / mean)
            descent.update(step)
            del step  # it is the volume with momentum now
            if listener(iteration, update, square, rays, descent.x):
                return Volume(descent.x, A.grid)
    return Volume(descent.x, A.grid)


def _total(rest: Singles, trust: Singles, views: list[int]) -> tuple[float, int]:
    """Return the sum of squared residuals over the rays that count, and their number."""
    square, rays = 0.0, 0
    for image, view in zip(rest, views, strict=True):
        counts = trust[view] > 0
        square += sum_of_squares(image[None, counts])
        rays += int(counts.sum())
    return square, rays


def _trust(A: Projector, weights: NDArray[Any] | None, mask: Mask | None) -> Singles:
    """Return W for the rays that count, and 0 for the others."""
    counts, trust = counting_rays(A, mask)
    for view, image in enumerate(trust):
        image[:] = counts[view] if weights is None else np.where(counts[view], weights[view], 0)
    return trust


def _curvature(parts: list[tuple[Projector, list[int]]], trust: Singles) -> tuple[Singles, float]:
    """Return the row sums of A^T W A, as shares of their mean but not below a least one; the mean.

    A row sum is the largest over the subsets times their number.
    """
    largest = np.zeros(parts[0][0].domain_shape, np.float32)
    ones = np.ones_like(largest)
    for part, views in parts:
        rows = part(ones)
        for view, image in zip(views, rows, strict=True):
            image *= trust[view]
        np.maximum(largest, part.T(rows), out=largest)
    largest *= np.float32(len(parts))
    mean = float(largest.mean(dtype=np.float64))
    largest /= np.float32(mean)
    return np.maximum(largest, np.float32(LEAST_WEIGHT), out=largest), mean
