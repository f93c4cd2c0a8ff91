"""Predicted detectability against the exact linear value, and against noisy reconstructions.

    python benchmarks/bench_detectability.py [--noisy 0] [--processes 2] [--only NAME ...]

A ball of 8 mm in the middle of an ellipsoid of 56 x 120 x 90 mm with two denser rods; 64^3 voxels
of 2 mm, 60 views of 80 x 60 pixels of 4 mm, ten trajectories of the same photons a pixel. Exact:
with F = A^T D A and H = F + beta R, template t = H^-1 F s and d' = t.t / sqrt(z.F z) with
z = H^-1 t, each H^-1 one solve by conjugate gradients. Noisy: the spread of t.x over
reconstructions x of independent noise, on the trajectories with the highest and lowest d'.
"""

from __future__ import annotations

import argparse
import time
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from scipy.sparse.linalg import LinearOperator, cg
from scipy.stats import spearmanr

from twinct.geometry import Panel, VolumeGrid
from twinct.planning import Task, detectability_of
from twinct.planning.detectability import difference_spectrum
from twinct.recon import Projector
from twinct.trajectory import (
    ArcTrajectory,
    CircleTrajectory,
    SaddleTrajectory,
    SinusoidTrajectory,
    UniformTrajectory,
    commanded_views,
)

SIZE, VOXEL, PHOTONS, BETA = 64, 2.0, 1e4, 3e4
PANEL = Panel(60, 80, 4.0, 4.0)
GRID = VolumeGrid((SIZE,) * 3, VOXEL)
PLACE = SIZE // 2
TOLERANCE, MOST = 1e-3, 1000
"""Residual of a solve, relative, and its steps: 1e-2 and 1e-4 of a circle differ by 0.2 % of d'.

An arc of 60 deg takes hundreds of steps; one that has not converged is no truth, and is refused.
"""


def trajectories():
    arc = {"kind": "arc", "views": 60}
    circle = {"kind": "circle", "views": 60}
    return {
        "circle": CircleTrajectory(**circle),
        "circle tilted 30 deg": CircleTrajectory(**circle, tilt_deg=30),
        "circle tilted 60 deg": CircleTrajectory(**circle, tilt_deg=60),
        "circle tilted 60 deg about y": CircleTrajectory(**circle, tilt_deg=60, tilt_axis_deg=90),
        "60 deg about x": ArcTrajectory(**arc, longitude_range_deg=60),
        "60 deg about y": ArcTrajectory(**arc, longitude_range_deg=60, centre_longitude_deg=90),
        "120 deg": ArcTrajectory(**arc, longitude_range_deg=120, centre_longitude_deg=45),
        "paper's": SinusoidTrajectory(kind="sinusoid", views=60),
        "saddle": SaddleTrajectory(kind="saddle", views=60, latitude_amplitude_deg=40),
        "uniform": UniformTrajectory(kind="uniform", views=60, latitude_range_deg=(-80, 80)),
    }


def phantom():
    z, y, x = np.meshgrid(*[(np.arange(SIZE) - (SIZE - 1) / 2) * VOXEL] * 3, indexing="ij")
    mu = np.where((x / 28) ** 2 + (y / 60) ** 2 + (z / 45) ** 2 < 1, 0.025, 0.0)
    mu[((x - 16) ** 2 + (y - 5) ** 2 < 16) & (np.abs(z) < 25)] = 0.06
    mu[((z + 20) ** 2 + (y - 5) ** 2 < 16) & (np.abs(x) < 18)] = 0.06
    return mu.astype(np.float32)


def signal():
    z, y, x = np.indices((SIZE,) * 3) - PLACE
    radius = np.sqrt(z * z + y * y + x * x) * VOXEL
    return 0.002 * np.clip((4 - radius) / VOXEL + 0.5, 0, 1)


def differences(v):
    """R v: differences to the neighbours that there are."""
    out = np.zeros_like(v)
    for axis in range(3):
        d = np.diff(v, axis=axis)
        low, high = [slice(None)] * 3, [slice(None)] * 3
        low[axis], high[axis] = slice(None, -1), slice(1, None)
        out[tuple(low)] -= d
        out[tuple(high)] += d
    return out


class Linear:
    """The reconstruction of one trajectory."""

    def __init__(self, section) -> None:
        self.projector = Projector(commanded_views(section, PANEL), GRID)
        self.photons = PHOTONS * np.exp(-self.projector(phantom()))
        start = time.perf_counter()
        self.found = detectability_of(self.projector, self.photons, Task(signal(), BETA))
        self.predicted = self.found(np.ones(len(self.projector)))
        self.seconds = time.perf_counter() - start
        f = self.found.fisher.sum(axis=0, dtype=float)
        self._filter = f + BETA * difference_spectrum((SIZE, SIZE, SIZE))
        self._filter = np.maximum(self._filter, self._filter[self._filter > 0].min())
        # How certain each voxel is against the place (Fessler, Booth 1999); of the solver only.
        share = self.projector.T(self.photons) / np.maximum(
            self.projector.T(np.ones_like(self.photons)), 1e-3
        )
        self._certain = np.maximum(np.sqrt(share / share[PLACE, PLACE, PLACE]), 0.2)

    def fisher(self, v):
        v = v.reshape(GRID.shape).astype(np.float32)
        return self.projector.T(self.photons * self.projector(v)).astype(float)

    def solve(self, right):
        n = right.size
        apply = LinearOperator((n, n), matvec=self._hessian, dtype=float)
        near = LinearOperator((n, n), matvec=self._near, dtype=float)
        found, left = cg(apply, right.ravel(), rtol=TOLERANCE, M=near, maxiter=MOST)
        assert left == 0, f"conjugate gradients have not converged after {MOST} steps"
        return found

    def _hessian(self, v):
        v = v.reshape(GRID.shape)
        return (self.fisher(v) + BETA * differences(v)).ravel()

    def _near(self, v):
        v = np.fft.rfftn(v.reshape(GRID.shape) / self._certain) / self._filter
        return (np.fft.irfftn(v, s=GRID.shape, axes=(0, 1, 2)) / self._certain).ravel()


def exact(name):
    one = Linear(trajectories()[name])
    template = one.solve(one.fisher(signal()))
    back = one.solve(template)
    value = float(template @ template / np.sqrt(back @ one.fisher(back).ravel()))
    told = f"exact {value:.3f}, predicted {one.predicted:.3f} in {one.seconds:.1f} s"
    print(f"{name}: {told}, ratio {one.predicted / value:.3f}", flush=True)
    return value, one.predicted


def noisy(name, number):
    one = Linear(trajectories()[name])
    template = one.solve(one.fisher(signal()))
    rng = np.random.default_rng([15, number])
    found = []
    for _ in range(number):
        noise = rng.normal(size=one.photons.shape) / np.sqrt(one.photons)
        found.append(one.solve(one.projector.T(one.photons * noise).astype(float)) @ template)
    return float(template @ template / np.std(found))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--noisy", type=int, default=200)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--only", nargs="*", default=list(trajectories()))
    options = parser.parse_args()
    with ProcessPoolExecutor(options.processes) as pool:
        values, predicted = np.array(list(pool.map(exact, options.only))).T
        ratio = predicted / values
        scale = np.exp(np.log(ratio).mean())
        print(
            f"{len(values)} trajectories: d' spread {values.max() / values.min():.2f}-fold, rank "
            f"correlation {spearmanr(values, predicted)[0]:.3f}, common scale {scale:.3f}, "
            f"then off by at most {100 * np.abs(ratio / scale - 1).max():.1f} %",
            flush=True,
        )
        if options.noisy:
            ends = [int(values.argmax()), int(values.argmin())]
            names = [options.only[k] for k in ends]
            spread = pool.map(noisy, names, [options.noisy] * 2)
            for name, k, value in zip(names, ends, spread, strict=True):
                print(
                    f"{name}: {options.noisy} noisy reconstructions {value:.3f} (one sigma "
                    f"{100 / np.sqrt(2 * options.noisy):.0f} %), exact {values[k]:.3f}, predicted "
                    f"{predicted[k] / scale:.3f} after the common scale",
                    flush=True,
                )


if __name__ == "__main__":
    main()
