"""Weighted least squares plus total variation, by ordered subsets of views with momentum.

    0.5 |A x - p|_W^2 / d + strength TV(x),   x >= floor,   TV(x) = integral of |grad x| over mm^3

d is the mean curvature of the data term, so that the strength is in mm times the unit of x. The
method is FISTA (Beck, Teboulle 2009) with ordered subsets and a momentum that continues from subset
to subset (Kim, Ramani, Fessler 2015). With B the voxel-driven back projection of ``sart`` in the
place of the adjoint, and L the rays' path lengths, the step of each voxel is

    z <- z + B W (p - A z) / B W L

over the views of a subset: a separable quadratic surrogate, since A 1 = L. The proximal step solves
the dual problem (Chambolle 2004) in that metric, starting from the dual of the previous update.

Memory decides which grids are possible, so there are three and a half volumes and a few planes: x,
z, and the dual in 16 bits. B W L is kept in voxels twice as large, and residuals as images of the
subset's views, which are then added to z in place.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from twinct.geometry import Pose, VolumeGrid
from twinct.recon.engine import Singles
from twinct.recon.fista import LEAST_WEIGHT, Descent, Variation
from twinct.recon.levels import Level
from twinct.recon.order import subsets_of
from twinct.recon.ray_weights import RayWeights
from twinct.recon.steps import sum_of_squares

SUBSETS = 10
"""Updates of a pass: more amplify noise, fewer need more passes."""

FEWEST_IN_SUBSET = 5
"""Views of a subset, at least: the skull from 20 views diverges in subsets of 2 (57 % error), and
has 10.0, 9.4, 9.8 and 11.0 % in subsets of 3, 5, 7 and 10; from 32 views, 7.2 and 6.4 % in subsets
of 3 and 5."""

DUAL_STEPS = 3
"""Steps of the dual iteration in each update; 5 give the volume of 3 to a hundredth."""

EACH = 8
"""The change of the volume is measured in each plane of so many, which saves a copy of the rest."""

Notify = Callable[[float, int, Singles], bool]
"""Function of the sum of squared residuals before an update, the number of rays, and the volume."""


class Minimiser:
    """Volume on its way to the minimum of the objective.

    Attributes:
        level: the scan.
        weights: weights of the rays.
        mean: d, the mean curvature of the data term, in the unit of the weights times mm.
        change: root mean square of the change in the last pass, relative to the volume.
    """

    def __init__(self, level: Level, x: Singles, weights: RayWeights, floor: float) -> None:
        """Take a volume to start from, which is overwritten."""
        A = level.A
        self.level, self.weights, self.change = level, weights, math.inf
        self._views = subsets_of(A.geometry, subsets_for(len(A)))
        curvature = self._curvature()
        seen = curvature[curvature > 0]
        self.mean = float(seen.mean(dtype=np.float64)) if seen.size else 1.0
        curvature /= np.float32(self.mean)
        np.maximum(curvature, np.float32(LEAST_WEIGHT), out=curvature)
        self._descent = Descent(x, curvature, Variation(A, 0.0, DUAL_STEPS, np.float32(floor)))

    @property
    def x(self) -> Singles:
        """The volume, (z, y, x)."""
        return self._descent.x

    @property
    def strength(self) -> float:
        """Strength of the total variation."""
        return self._descent.variation.strength

    @strength.setter
    def strength(self, value: float) -> None:
        self._descent.variation.strength = value

    def start(self, x: Singles) -> None:
        """Go on from a volume, which is overwritten, without momentum."""
        self._descent.start(x)

    def one_pass(self, notify: Notify | None = None) -> bool:
        """Update the volume with each subset; return True if ``notify`` ends it."""
        begun = self.x[::EACH].copy()
        for views in self._views:
            square, rays = self._update(views)
            if notify is not None and notify(square, rays, self.x):
                return True
        begun -= self.x[::EACH]
        size = sum_of_squares(self.x[::EACH])
        self.change = math.sqrt(sum_of_squares(begun) / size) if size else 0.0
        return False

    def _update(self, views: list[int]) -> tuple[float, int]:
        """Step with some views; return the sum of their squared residuals before, and the rays."""
        A, descent, square, rays = self.level.A, self._descent, 0.0, 0
        share = np.float32(len(self._views) / self.mean)
        images: list[Singles] = []
        for view in views:
            rest, weights = residual(self.level, self.weights, descent.held, view)
            square += sum_of_squares((rest * (weights > 0))[None])
            rays += int(np.count_nonzero(weights))
            images.append(rest * weights * share)
        total = descent.weighted()
        for view, image in zip(views, images, strict=True):
            A.add_image(image, view, total)
        descent.settle()
        return square, rays

    def _curvature(self) -> Singles:
        """Return B W L, the largest over the subsets times their number, in ``halved`` voxels.

        It is as smooth as the rays' path lengths.
        """
        larger = self.level.A.on(halved(self.level.A.grid))
        most = np.zeros(larger.domain_shape, np.float32)
        for views in self._views:
            total = np.zeros_like(most)
            held = larger.kernels.hold(total)
            for view in views:
                image = self.weights.of_level(self.level, view) * self.level.A.chords_of(view)
                larger.add_image(image, view, held)
            larger.kernels.bring(held, total)
            np.maximum(most, total, out=most)
        most *= np.float32(len(self._views))
        return most


def halved(grid: VolumeGrid) -> VolumeGrid:
    """Return a grid of voxels twice as large, along axes of at least four, from one corner.

    The last voxel of an odd number is twice as large, too.
    """
    factors = np.where(np.array(grid.shape_xyz) < 4, 1, 2)
    numbers = -(-np.array(grid.shape_xyz) // factors)
    beyond = (numbers * factors - grid.shape_xyz) * grid.voxel / 2
    place = grid.world_from_grid @ Pose.from_matrix(beyond, np.eye(3))
    return VolumeGrid(numbers[::-1].tolist(), factors * grid.voxel, place)


def subsets_for(views: int) -> int:
    """Return the number of subsets of so many views."""
    return max(1, min(SUBSETS, views // FEWEST_IN_SUBSET))


def residual(level: Level, weights: RayWeights, x: Any, view: int) -> tuple[Singles, Singles]:
    """Return a view's p - A x, and the weights of its rays: 0 where they do not count.

    Args:
        level: the scan.
        weights: weights of its rays.
        x: volume, (z, y, x), or held by the kernels.
        view: number of the view.
    """
    estimate, lengths = level.A.line_integrals_of(x, view)
    rest = level.measured(view) - estimate
    counts = lengths >= np.float32(level.A.grid.voxel.min())
    return rest, np.where(counts, weights.of_level(level, view), np.float32(0))
