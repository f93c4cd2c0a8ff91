"""Predicted detectability against the exact linear value, and against noisy reconstructions.

    python benchmarks/bench_detectability.py --out out/detectability [--noisy 0] [--processes 2]

A ball of 8 mm in the middle of an ellipsoid of 40 x 120 x 108 mm with two denser rods; 64^3 voxels
of 2 mm, 60 views of 80 x 60 pixels of 4 mm, ten trajectories of the same photons a pixel before the
object, whose rays go along its short axis or across. Exact: with F = A^T D A and H = F + beta R,
template t = H^-1 F s and d' = t.t / sqrt(z.F z) with z = H^-1 t, each H^-1 one solve by conjugate
gradients. Noisy: the spread of t.x over reconstructions x of independent counts, each solved, on
the circle and on the trajectory with the lowest d' (that with the highest takes ten times as many
steps). How far each solve is from its limit is known: of one that has converged t.x = z.b, with b
its right side. Results are kept in the folder; a later call goes on.
"""

from __future__ import annotations

import argparse
import json
from concurrent.futures import ProcessPoolExecutor
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse.linalg import LinearOperator, cg
from scipy.stats import spearmanr

from twinct.geometry import Panel, VolumeGrid
from twinct.recon import Projector
from twinct.trajectory import (
    ArcTrajectory,
    CircleTrajectory,
    SaddleTrajectory,
    SinusoidTrajectory,
    UniformTrajectory,
    commanded_views,
)
from twinct.view_planning import Task, detectability_of
from twinct.view_planning.objectives.detectability import difference_spectrum

SIZE, VOXEL, PHOTONS, BETA = 64, 2.0, 1e4, 3e4
PANEL = Panel(60, 80, 4.0, 4.0)
GRID = VolumeGrid((SIZE,) * 3, VOXEL)
PLACE = SIZE // 2
TOLERANCE, NOISY_TOLERANCE, MOST = 1e-4, 1e-1, 1000
"""Residuals of a solve, relative, and its steps; one that has not converged is no truth."""

NOISED = ("circle", "circle tilted 85 deg about y")
UNSOLVED = 0.1
"""How far t.x of a solve may be from its limit, of its spread: root mean square."""


def trajectories() -> dict[str, Any]:
    arc, circle = {"kind": "arc", "views": 60}, {"kind": "circle", "views": 60}
    return {
        "circle": CircleTrajectory(**circle),
        "circle tilted 60 deg": CircleTrajectory(**circle, tilt_deg=60),
        "circle tilted 60 deg about y": CircleTrajectory(**circle, tilt_deg=60, tilt_axis_deg=90),
        "circle tilted 85 deg about y": CircleTrajectory(**circle, tilt_deg=85, tilt_axis_deg=90),
        "120 deg about x": ArcTrajectory(**arc, longitude_range_deg=120),
        "120 deg about y": ArcTrajectory(**arc, longitude_range_deg=120, centre_longitude_deg=90),
        "200 deg about y": ArcTrajectory(**arc, longitude_range_deg=200, centre_longitude_deg=90),
        "paper's": SinusoidTrajectory(kind="sinusoid", views=60),
        "saddle": SaddleTrajectory(kind="saddle", views=60, latitude_amplitude_deg=40),
        "uniform": UniformTrajectory(kind="uniform", views=60, latitude_range_deg=(-80, 80)),
    }


def phantom() -> np.ndarray:
    z, y, x = np.meshgrid(*[(np.arange(SIZE) - (SIZE - 1) / 2) * VOXEL] * 3, indexing="ij")
    mu = np.where((x / 20) ** 2 + (y / 60) ** 2 + (z / 54) ** 2 < 1, 0.035, 0.0)
    mu[((x - 12) ** 2 + (y - 5) ** 2 < 16) & (np.abs(z) < 25)] = 0.06
    mu[((z + 20) ** 2 + (y - 5) ** 2 < 16) & (np.abs(x) < 14)] = 0.06
    return mu.astype(np.float32)


def signal() -> np.ndarray:
    z, y, x = np.indices((SIZE,) * 3) - PLACE
    radius = np.sqrt(z * z + y * y + x * x) * VOXEL
    return 0.002 * np.clip((4 - radius) / VOXEL + 0.5, 0, 1)


def differences(v: np.ndarray) -> np.ndarray:
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

    def __init__(self, name: str) -> None:
        self.projector = Projector(commanded_views(trajectories()[name], PANEL), GRID)
        self.photons = PHOTONS * np.exp(-self.projector(phantom()))
        found = detectability_of(self.projector, self.photons, Task(signal(), BETA))
        self.predicted = found(np.ones(len(self.projector)))
        # Of the solver only: the kernel's end weighed down by a triangle, so that no power is
        # negative, and how certain each voxel is against the place (Fessler, Booth 1999).
        near = 1 - 2 * np.abs(np.fft.fftfreq(SIZE))
        summed = found.fisher.sum(axis=0, dtype=float)
        kernel = np.fft.irfftn(summed, s=GRID.shape, axes=(0, 1, 2))
        told = np.fft.rfftn(kernel * near[:, None, None] * near[:, None] * near).real
        self._filter = np.maximum(told, 0) + BETA * difference_spectrum((SIZE, SIZE, SIZE))
        self._filter = np.maximum(self._filter, self._filter[self._filter > 0].min())
        share = self.projector.T(self.photons) / np.maximum(
            self.projector.T(np.ones_like(self.photons)), 1e-3
        )
        self._certain = np.maximum(np.sqrt(share / share[PLACE, PLACE, PLACE]), 0.2)

    def fisher(self, v: np.ndarray) -> np.ndarray:
        v = v.reshape(GRID.shape).astype(np.float32)
        return self.projector.T(self.photons * self.projector(v)).astype(float)

    def solve(self, right: np.ndarray, tolerance: float = TOLERANCE) -> np.ndarray:
        n = right.size
        apply = LinearOperator((n, n), matvec=self._hessian, dtype=float)
        near = LinearOperator((n, n), matvec=self._near, dtype=float)
        found, left = cg(apply, right.ravel(), rtol=tolerance, M=near, maxiter=MOST)
        assert left == 0, f"conjugate gradients have not converged after {MOST} steps"
        return found

    def _hessian(self, v: np.ndarray) -> np.ndarray:
        v = v.reshape(GRID.shape)
        return (self.fisher(v) + BETA * differences(v)).ravel()

    def _near(self, v: np.ndarray) -> np.ndarray:
        v = np.fft.rfftn(v.reshape(GRID.shape) / self._certain) / self._filter
        return (np.fft.irfftn(v, s=GRID.shape, axes=(0, 1, 2)) / self._certain).ravel()


def exact(name: str, folder: Path) -> tuple[float, float]:
    file = folder / f"{name}.npz"
    if not file.exists():
        one = Linear(name)
        template = one.solve(one.fisher(signal()))
        back = one.solve(template)
        value = float(template @ template / np.sqrt(back @ one.fisher(back).ravel()))
        np.savez(file, template=template, values=[value, one.predicted])
    value, predicted = np.load(file)["values"].tolist()
    print(f"{name}: exact {value:.3f}, predicted {predicted:.3f}, ratio {predicted / value:.3f}")
    return value, predicted


def noisy(name: str, number: int, folder: Path) -> tuple[float, float]:
    """D' by the spread over reconstructions; how far solves are from their limits, of it."""
    template, log = np.load(folder / f"{name}.npz")["template"], folder / f"{name}.jsonl"
    done: list[tuple[float, float]] = (
        [json.loads(line) for line in log.open()] if log.exists() else []
    )
    one = Linear(name)
    back = one.solve(template)
    with log.open("a") as stream:
        for seed in range(len(done), number):
            counts = np.random.default_rng([15, seed]).poisson(one.photons)
            noise = (counts - one.photons) / one.photons
            right = one.projector.T((one.photons * noise).astype(np.float32)).astype(float)
            solved = float(one.solve(right, NOISY_TOLERANCE) @ template)
            done.append((solved, float(back @ right.ravel())))
            stream.write(f"{json.dumps(done[-1])}\n")
            stream.flush()
    solved, limits = np.array(done[:number]).T
    off = float(np.sqrt(np.mean((solved - limits) ** 2)) / limits.std())
    assert off < UNSOLVED, f"{name}: solves are {off:.2f} of the spread from their limits"
    return float(template @ template / solved.std()), off


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--noisy", type=int, default=200)
    parser.add_argument("--processes", type=int, default=2)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    names = list(trajectories())
    with ProcessPoolExecutor(options.processes) as pool:
        values, predicted = np.array(list(pool.map(exact, names, repeat(options.out)))).T
        ratio = predicted / values
        scale = np.exp(np.log(ratio).mean())
        print(
            f"{len(values)} trajectories: d' spread {values.max() / values.min():.2f}-fold, rank "
            f"correlation {spearmanr(values, predicted)[0]:.3f}, common scale {scale:.3f}, "
            f"then off by at most {100 * np.abs(ratio / scale - 1).max():.1f} %",
            flush=True,
        )
        if options.noisy:
            spread = pool.map(noisy, NOISED, repeat(options.noisy), repeat(options.out))
            for name, (value, off) in zip(NOISED, spread, strict=True):
                k = names.index(name)
                print(
                    f"{name}: {options.noisy} noisy reconstructions {value:.3f} (one sigma "
                    f"{100 / np.sqrt(2 * options.noisy):.0f} %; solved to {off:.3f} of it), "
                    f"exact {values[k]:.3f}, predicted {predicted[k] / scale:.3f} after the common "
                    "scale",
                    flush=True,
                )


if __name__ == "__main__":
    main()
