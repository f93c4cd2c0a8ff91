"""Weighted least squares plus total variation, by ordered subsets of views with momentum.

    0.5 |A x - p|_W^2 / d + strength TV(x),   x >= floor,   TV(x) = integral of |grad x| over mm^3

d is the mean curvature of the data term, so that the strength is in mm times the unit of x. The
method is FISTA (Beck, Teboulle 2009) with ordered subsets and a momentum that continues from subset
to subset (Kim, Ramani, Fessler 2015). With B the voxel-driven back projection of ``sart`` in the
place of the adjoint, and L the rays' path lengths, the step of each voxel is

    z <- z + B W (p - A z) / B W L

over the views of a subset: a separable quadratic surrogate, since A 1 = L. The proximal step solves
the dual problem (Chambolle 2004) in that metric, starting from the dual of the previous update.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from twinct.recon.checks import mask_of
from twinct.recon.engine import Ratio, Singles
from twinct.recon.levels import Level
from twinct.recon.order import subset_number, subsets_of
from twinct.recon.projector import LOWEST
from twinct.recon.ray_weights import RayWeights
from twinct.recon.steps import sum_of_squares

DUAL_STEPS, DUAL_STEP = 5, 1.8
"""Steps of the dual iteration in each update, and their size; it no longer converges at 2."""

LEAST = 0.05
"""Smallest curvature of a voxel, as a share of the mean; larger values make smaller, safe steps."""


class Minimiser:
    """Volume on its way to the minimum of the objective.

    Attributes:
        x: the volume, (z, y, x).
        strength: strength of the total variation; it may be changed between passes.
        mean: d, the mean curvature of the data term.
        subsets: number of updates in a pass.
        change: root mean square of the change in the last pass, relative to the volume.
    """

    def __init__(self, level: Level, x: Singles, weights: RayWeights, floor: float) -> None:
        """Take a start, which is overwritten."""
        A = level.A
        self.level, self.weights, self.floor = level, weights, np.float32(floor)
        self.x, self.change, self.strength = x, math.inf, 0.0
        self._views = subsets_of(A.geometry, subset_number(None, len(A)))
        self.subsets = len(self._views)
        rows, columns = A.range_shape[1:]
        self._ratio = Ratio.room(A.kernels, rows, columns)
        self._ratio.counts[:], self._ratio.missing[:] = 1.0, 0
        self._estimate, self._length = (np.empty((rows, columns), np.float32) for _ in range(2))
        self._sum = np.zeros_like(x)
        self._curvature = np.zeros_like(x)
        for views in self._views:
            np.maximum(self._curvature, self._path_lengths(views), out=self._curvature)
        self._curvature *= np.float32(self.subsets)
        seen = self._curvature[self._curvature > 0]
        self.mean = float(seen.mean(dtype=np.float64)) if seen.size else 1.0
        self._curvature /= np.float32(self.mean)
        np.maximum(self._curvature, np.float32(LEAST), out=self._curvature)
        self._dual = np.zeros((3, *x.shape), np.float32)
        self._before = np.empty_like(x)
        self.start()

    def start(self) -> None:
        """Forget the momentum."""
        self._z, self._momentum = self.x.copy(), 1.0

    def one_pass(self, notify: Any = None) -> bool:
        """Update the volume with each subset; return True if ``notify`` ends it.

        Args:
            notify: called after each update with the sum of squared residuals before it, the number
                of rays, and the volume.
        """
        begun = self.x.copy()
        for views in self._views:
            square, rays = self._update(views)
            if notify is not None and notify(square, rays, self.x):
                return True
        begun -= self.x
        size = sum_of_squares(self.x)
        self.change = math.sqrt(sum_of_squares(begun) / size) if size else 0.0
        return False

    def _update(self, views: list[int]) -> tuple[float, int]:
        A, kernels, z = self.level.A, self.level.A.kernels, self._z
        inverse, curvature = 1.0 / A.grid.voxel, self._curvature
        square, rays = self._residuals(views)
        step = self._sum
        step *= np.float32(self.subsets / self.mean)
        step /= curvature
        z += step
        self._before, self.x = self.x, self._before
        x = self.x
        for _ in range(DUAL_STEPS if self.strength > 0 else 0):
            kernels.primal(z, curvature, self._dual, inverse, self.floor, x)
            kernels.ascend(x, curvature, inverse, self.strength, DUAL_STEP, self._dual)
        kernels.primal(z, curvature, self._dual, inverse, self.floor, x)
        A.blocks.clear(x)
        self._momentum, last = (1 + math.sqrt(1 + 4 * self._momentum**2)) / 2, self._momentum
        share = np.float32((last - 1) / self._momentum)
        for plane, new, old in zip(z, x, self._before, strict=True):
            np.subtract(new, old, out=plane)
            plane *= share
            plane += new
        return square, rays

    def _residuals(self, views: list[int]) -> tuple[float, int]:
        """Back project the weighted residuals of some views; return their squares, and the rays."""
        A, square, rays = self.level.A, 0.0, 0
        self._sum[:] = 0.0
        for view in views:
            rest, weights = self._rest(self._z, view)
            square += sum_of_squares((rest * (weights > 0))[None])
            rays += int(np.count_nonzero(weights))
            self._add(rest * weights, view)
        return square, rays

    def _rest(self, x: Singles, view: int) -> tuple[Singles, Singles]:
        A, measured = self.level.A, self.level.measured(view)
        A.kernels.forward(x, A._rays[view], self._estimate, A.blocks, self._length)
        weights = self._weights(view)
        weights *= self._length >= float(A.grid.voxel.min())
        return measured - self._estimate, weights

    def _weights(self, view: int) -> Singles:
        level = self.level
        found, good = self.weights(level.p[view], view), mask_of(level.pixels, view)
        return found if good is None else np.where(good, found, np.float32(0))

    def _path_lengths(self, views: list[int]) -> Singles:
        A = self.level.A
        self._sum[:] = 0.0
        for view in views:
            A.kernels.chords(A._rays[view], A.domain_shape, self._length)
            self._add(self._weights(view) * self._length, view)
        return self._sum

    def _add(self, image: Singles, view: int) -> None:
        A, ratio = self.level.A, self._ratio
        ratio.image[1:-1, 1:-1] = image
        ratio.image[0], ratio.image[-1] = ratio.image[1], ratio.image[-2]
        ratio.image[:, 0], ratio.image[:, -1] = ratio.image[:, 1], ratio.image[:, -2]
        A.kernels.update(self._sum, A._pixels[view], *ratio, np.float32(LOWEST), A.blocks)
