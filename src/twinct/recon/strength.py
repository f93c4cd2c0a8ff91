"""Strength of the total variation: as strong as whole views that were left out allow.

Errors of the rays push each voxel. From V views with pixels of pitch q (at the grid), an error s of
a line integral with the weight w changes the gradient of the data term by w s sqrt(V) a^2 / q in a
voxel of edge a, since a^2 / q^2 rays of each view cross it. The total variation opposes that with
strength d a^2 at each of the voxel's faces. So a strength of w s sqrt(V) / (q d) holds it back.

That is enough for noise, which differs from ray to ray. The model's error does not, and some
objects have fewer borders than others: how much stronger its part has to be, a trial shows. It
reconstructs most of the views with strengths that rise by a factor of two, and predicts the others.
The strongest one is taken whose residuals are about as small as the least: a volume that is wrong
may explain all views a little better than the truth does, by a share of the model's error.

The trial takes place in voxels and pixels twice as large. Its factor holds for finer ones.
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
from twinct.recon.ordered_subsets import Minimiser, residual
from twinct.recon.ray_weights import RayWeights

log = logging.getLogger(__name__)

OF_NOISE = 0.8
"""Strength that noise alone needs, relative to the one that holds back its standard deviation."""

EVIDENCE = 0.15
"""Share of the model's error by which mean squared residuals may differ without being evidence."""

FIRST, LAST = -1, 5
"""Powers of two of the factors that are tried; while the first is the best, down to -LAST, too."""

PARTS, FEWEST_VIEWS = 10, 20
"""One view of so many is left out; with fewer views than the second number, none is."""


@dataclass(frozen=True)
class Forces:
    """Strengths that hold back what noise, and the model's error, do to a voxel.

    Attributes:
        noise: for the noise.
        model: for the model's error, times the factor of the trial.
    """

    noise: float
    model: float

    @classmethod
    def of(cls, minimiser: Minimiser) -> Forces:
        """Return those of a level, relative to the mean curvature of its data term."""
        A = minimiser.level.A
        depth = A.geometry.depth(A.grid.world_from_grid.position)
        panel = A.geometry.panel
        pitch = math.sqrt(panel.pitch_u * panel.pitch_v) * float(np.mean(depth / A.geometry.sdd))
        unit = math.sqrt(len(A)) * pitch / minimiser.mean
        noise, model = minimiser.weights.forces(minimiser.level)
        return cls(OF_NOISE * unit * noise, unit * model)

    def strength(self, factor: float) -> float:
        """Return the strength for a factor on that of the model's error."""
        return math.hypot(self.noise, factor * self.model)


@dataclass(frozen=True, eq=False)
class Trial:
    """Residuals of left-out views for some factors.

    Attributes:
        factors: rising.
        misfits: mean weighted squares of the residuals, for each factor.
        allowed: by so much a misfit may exceed the least.
    """

    factors: Floats
    misfits: Floats
    allowed: float

    @property
    def factor(self) -> float:
        """The largest factor whose misfit is about as small as the least."""
        most = self.misfits.min() + self.allowed
        last = int(np.flatnonzero(self.misfits <= most)[-1])
        if last + 1 == len(self.factors):
            return float(self.factors[last])
        below, above = self.misfits[last : last + 2]
        share = float((most - below) / (above - below))
        return float(self.factors[last] * (self.factors[last + 1] / self.factors[last]) ** share)


def tried(level: Level, x: Singles, weights: RayWeights, floor: float) -> Trial | None:
    """Try strengths on views that are left out; None if there are too few views.

    Args:
        level: the scan.
        x: volume to start from, (z, y, x); it is not changed.
        weights: weights of the rays.
        floor: lower bound of all voxels.
    """
    A = level.A
    if len(A) < FEWEST_VIEWS:
        log.info("%d views are too few to leave any out: factor 1", len(A))
        return None
    out = sorted(subsets_of(A.geometry, PARTS)[0])
    used = sorted(set(range(len(A))) - set(out))
    judges, own = level.of_views(out), weights.of_views(out)
    minimiser = Minimiser(level.of_views(used), x.copy(), weights.of_views(used), floor)
    forces, begun = Forces.of(minimiser), x
    found: dict[int, float] = {}
    allowed = 0.0

    def misfit(power: int, start: Singles) -> tuple[float, float]:
        minimiser.strength = forces.strength(2.0**power)
        minimiser.start(start)
        minimiser.one_pass()
        return _misfit(judges, own, minimiser.x)

    for power in range(FIRST, LAST + 1):
        found[power], allowed = misfit(power, minimiser.x)
        if found[power] > min(found.values()) + allowed:
            break
    power = FIRST
    while found[power] == min(found.values()) and power > -LAST:
        power -= 1
        start = begun.copy() if power == FIRST - 1 else minimiser.x
        found[power], allowed = misfit(power, start)
    powers = sorted(found)
    trial = Trial(2.0 ** np.array(powers, float), np.array([found[one] for one in powers]), allowed)
    text = ", ".join(f"{found[one]:.4g} (2^{one})" for one in powers)
    log.info("left-out views: mean squared residuals %s; factor %.3g", text, trial.factor)
    return trial


def _misfit(level: Level, weights: RayWeights, x: Singles) -> tuple[float, float]:
    """Return the mean weighted square of residuals, and by how much others may exceed it."""
    square, model, rays = 0.0, 0.0, 0
    held = level.A.kernels.hold(x)
    for view in range(len(level.A)):
        rest, trust = residual(level, weights, held, view)
        square += float(np.sum(trust * np.square(rest), dtype=np.float64))
        model += float(np.sum(trust, dtype=np.float64)) * weights.model
        rays += int(np.count_nonzero(trust))
    return square / max(rays, 1), EVIDENCE * model / max(rays, 1)
