"""Strength of the total variation: as strong as whole views that were left out allow.

Errors of the rays push each voxel: V views with pixels of pitch q (at the grid) and an error s of a
line integral, with the weight w, change the gradient of the data term by w s sqrt(V) a^2 / q in a
voxel of edge a, since a^2 / q^2 rays of each view cross it. The total variation opposes that with
strength d a^2 at each of the voxel's faces. A strength of w s sqrt(V) / q / d holds it back. This
is where the trial starts: it is right to a factor of four.

The trial reconstructs most of the views with strengths that fall by a factor of two, and predicts
the others. Of the strengths whose residuals are about as small as the least, the strongest one is
taken. Residuals are about as small if their mean squares differ by less than a share of the model's
error: by so much, a wrong volume may explain the views better than the truth does.

The trial takes place in voxels and pixels twice as large. Its strength, relative to the one at
which it starts, holds for finer voxels.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass

import numpy as np

from twinct.geometry import Floats
from twinct.recon.engine import Singles
from twinct.recon.levels import Level
from twinct.recon.order import subsets_of
from twinct.recon.ordered_subsets import Minimiser
from twinct.recon.ray_weights import RayWeights

log = logging.getLogger(__name__)

EVIDENCE = 0.3
"""Share of the model's error by which mean squared residuals may differ."""

FIRST, LAST = -4, 4
"""Powers of two of the strengths of the trial, relative to that of the formula."""

PASSES = 2
"""Passes with each strength."""

PARTS = 10
"""One view of so many is left out."""

FEWEST_VIEWS = 20
"""Number of views below which none is left out."""


@dataclass(frozen=True, eq=False)
class Trial:
    """Residuals of left-out views.

    Attributes:
        powers: strengths, as powers of two, relative to that of the formula.
        misfits: mean weighted squares of the residuals, for each strength.
        allowed: by so much a misfit may exceed the least.
    """

    powers: Floats
    misfits: Floats
    allowed: float

    @property
    def factor(self) -> float:
        """Factor on the strength of the formula."""
        most = self.misfits.min() + self.allowed
        last = int(np.flatnonzero(self.misfits <= most)[-1])
        if last + 1 == len(self.powers):
            return float(2.0 ** self.powers[last])
        below, above = self.misfits[last], self.misfits[last + 1]
        share = (most - below) / (above - below)
        return float(2.0 ** (self.powers[last] + share))


def formula(minimiser: Minimiser) -> float:
    """Return the strength that holds back what the errors of the rays do to a voxel."""
    level, weights = minimiser.level, minimiser.weights
    A = level.A
    depth = A.geometry.depth(A.grid.world_from_grid.position)
    panel = A.geometry.panel
    pitch = math.sqrt(panel.pitch_u * panel.pitch_v) * float(np.mean(depth / A.geometry.sdd))
    force = weights.force(level.p, level.pixels)
    # A^T adds up what the pixels of a voxel's shadow see, and B their mean.
    return force * math.sqrt(len(A)) * pitch / minimiser.mean


def trial(level: Level, x: Singles, weights: RayWeights, floor: float) -> Trial | None:
    """Try strengths on the views that are left out; None if there are too few views.

    Args:
        level: the scan.
        x: volume to start from, (z, y, x); it is not changed.
        weights: weights of the rays.
        floor: lower bound of all voxels.
    """
    A = level.A
    if len(A) < FEWEST_VIEWS:
        return None
    out = sorted(subsets_of(A.geometry, PARTS)[0])
    used = sorted(set(range(len(A))) - set(out))
    minimiser = Minimiser(level.of_views(used), x.copy(), weights.of_views(used), floor)
    first = formula(minimiser)
    judge = level.of_views(out), weights.of_views(out)
    powers = list(range(FIRST, LAST + 1))
    misfits: list[float] = []
    for power in powers:
        minimiser.strength = first * 2.0**power
        minimiser.start()
        for _ in range(PASSES):
            minimiser.one_pass()
        misfit, model = _misfit(*judge, minimiser.x)
        misfits.append(misfit)
        if misfit > min(misfits) + 2 * EVIDENCE * model:
            break
    log.info("left-out views: %s", ", ".join(f"2^{p}: {m:.4g}" for p, m in zip(powers, misfits)))
    return Trial(np.array(powers[: len(misfits)], float), np.array(misfits), EVIDENCE * model)


def _misfit(level: Level, weights: RayWeights, x: Singles) -> tuple[float, float]:
    """Return the mean weighted square of residuals, and that of the model's error alone."""
    A, square, model, rays = level.A, 0.0, 0.0, 0
    estimate, length = (np.empty(A.range_shape[1:], np.float32) for _ in range(2))
    for view in range(len(A)):
        A.kernels.forward(x, A._rays[view], estimate, A.blocks, length)
        w = weights(level.p[view], view)
        if level.pixels is not None:
            from twinct.recon.checks import mask_of

            w = np.where(mask_of(level.pixels, view), w, np.float32(0))
        square += float(np.sum(w * np.square(level.measured(view) - estimate), dtype=np.float64))
        model += float(np.sum(w, dtype=np.float64)) * weights.model
        rays += int(np.count_nonzero(w))
    return square / max(rays, 1), model / max(rays, 1)
