"""FISTA (Beck, Teboulle 2009): its update, its proximal step, and a solver with exact adjoints.

``Descent`` and ``Variation`` serve all regularised algorithms; ``fast`` takes its gradients from
the voxel-driven back projection (``ordered_subsets``), ``minimised`` from the exact adjoint.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.recon.checks import Mask, counting_rays, remainder
from twinct.recon.engine import Singles
from twinct.recon.order import subsets_of
from twinct.recon.projector import LOWEST, Projector
from twinct.recon.steps import Callback, Listener, sum_of_squares
from twinct.recon.volume import Volume

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
    def seams(self) -> NDArray[np.intp]:
        """Flat indices of the voxels whose next neighbour is on the other side of the border.

        Differences across the border of the known region mean nothing.
        """
        seam = np.zeros_like(self.inside)
        for axis in range(3):
            along, border = (np.moveaxis(mask, axis, 0) for mask in (self.inside, seam))
            border[:-1] |= along[1:] != along[:-1]
        return np.flatnonzero(seam)

    def draw(self, z: Singles, curvature: Singles) -> Singles:
        """Move ``z`` towards the expected values, and return the curvature with their weights.

        0.5 |x - z|^2 plus the squared differences is another such term, up to a constant. Huber's
        loss is below a square that touches it at ``z`` (Huber and Dutter 1974).
        """
        both = np.empty_like(curvature)
        planes = zip(z, curvature, self.array, self.inside, both, strict=True)
        for here, own, there, known, total in planes:
            away = np.maximum(np.abs(here - there), np.float32(np.finfo(np.float32).tiny))
            weight = np.float32(self.closeness) * known
            weight *= np.minimum(np.float32(self.far) / away, np.float32(1))
            np.add(own, weight, out=total)
            here += weight / total * (there - here)
        return both


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
    dual: Singles = field(init=False)
    other: Singles = field(init=False)

    def __post_init__(self) -> None:
        """Set the duals to zero."""
        shape = 3, *self.A.domain_shape
        self.dual = np.zeros(shape, np.float32)
        self.other = np.zeros(shape if self.known else (3, 0, 0, 0), np.float32)

    def lower(self, z: Singles, curvature: Singles, x: Singles) -> None:
        """Write the minimiser of 0.5 |x - z|^2 in that metric plus this term to ``x``.

        Expected values that draw voxels change ``z``.
        """
        if self.known and self.known.closeness > 0:
            curvature = self.known.draw(z, curvature)
        kernels, inverse, known = self.A.kernels, 1.0 / self.A.grid.voxel, self.known
        if known is None:
            z, curvature, dual, lowered = map(kernels.hold, (z, curvature, self.dual, x))
            for _ in range(self.steps if self.strength > 0 else 0):
                kernels.primal(z, curvature, dual, inverse, self.floor, lowered)
                kernels.ascend(lowered, curvature, inverse, self.strength, DUAL_STEP, dual)
            kernels.primal(z, curvature, dual, inverse, self.floor, lowered)
            kernels.bring(dual, self.dual)
            kernels.bring(lowered, x)
            return
        room, others = np.empty_like(x), self.other.reshape(3, -1)
        own, share = (1 - known.share) * self.strength, known.share * self.strength
        for last in range(self.steps + 1):
            kernels.primal(z, curvature, self.dual, inverse, np.float32(LOWEST), room)
            kernels.primal(room, curvature, self.other, inverse, self.floor, x)
            if last == self.steps:
                return
            if own > 0:  # avoids a division by zero
                kernels.ascend(x, curvature, inverse, own, DUAL_STEP / 2, self.dual)
            if share > 0:
                np.subtract(x, known.array, out=room)
                kernels.ascend(room, curvature, inverse, share, DUAL_STEP / 2, self.other)
                others[:, known.seams] = 0.0


class Descent:
    """Volume on its way to the minimum of a data term and a variation: FISTA's updates.

    Attributes:
        x: the volume, (z, y, x).
        z: the volume with momentum, at which the data term's gradient is taken.
    """

    def __init__(self, x: Singles, curvature: Singles, variation: Variation) -> None:
        """Start from a volume, which is overwritten."""
        self.x, self.z, self.variation = x, x.copy(), variation
        self._curvature, self._momentum = curvature, 1.0

    def restart(self) -> None:
        """Forget the momentum."""
        self.z[:], self._momentum = self.x, 1.0

    def update(self, step: Singles) -> Singles:
        """Move by a step, the negative gradient; return room for the next step.

        The step's room takes the new volume.
        """
        step /= self._curvature
        self.z += step
        before, self.x = self.x, step
        self.variation.lower(self.z, self._curvature, self.x)
        self.variation.A.blocks.clear(self.x)
        self._momentum, last = (1 + math.sqrt(1 + 4 * self._momentum**2)) / 2, self._momentum
        share = np.float32((last - 1) / self._momentum)
        for plane, new, old in zip(self.z, self.x, before, strict=True):
            np.subtract(new, old, out=plane)
            plane *= share
            plane += new
        return before


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
            descent.restart()
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
            del step
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
