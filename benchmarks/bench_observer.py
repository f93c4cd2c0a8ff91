"""The detectability of a few scans against an ensemble of 200, of degraded volumes and of paths.

    python benchmarks/bench_observer.py --out out/observer [--seeds 10] [--ensemble 200] [--scans 4]

Degraded volumes: a signal (ball, radius 3 voxels, contrast 0.05) in white noise of 0.05, in 64^3
voxels, made worse in eight ways. Paths: circles of 30, 60 and 120 views with equal photons in all,
of balls of water and bone that are projected exactly, reconstructed by FDK in 48^3 voxels of 2 mm;
noise is Poisson's in each pixel. The few-seed figure is the one of ``evaluation.tasks``, once
per seed. The ensemble shares no draw and no code with it: 200 scans without the signal, and
with it and equal noise; the template is their mean difference, and the variance is taken
over scans and, of the mean volume, over the places of the region. Results are kept in the folder.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from twinct.evaluation import Measurement, Repeated, VoxelSet, ball
from twinct.evaluation.kinds.tasks import TASKS, USUAL_SCANS, DetectionTask
from twinct.geometry import Panel, Pose, VolumeGrid
from twinct.recon import Projector
from twinct.recon.fdk import fdk
from twinct.specimen.signals import Inserts, SphereSignal, contrast_at
from twinct.trajectory import CircleTrajectory, commanded_views
from twinct.xray.inserts import Insertion

Make = Callable[[np.ndarray | None, list[int]], np.ndarray]
"""Volume with signals at centres, (n, 3), mm, or without (None), and the key of its noise."""


_SHIFTS = 8
"""Sets of shifts within a voxel of the signals in the ensemble."""


@dataclass(frozen=True)
class Case:
    """One way to make volumes."""

    grid: VolumeGrid
    truth: np.ndarray
    region_mm: float
    signal: SphereSignal
    make: Make

    def region(self, name: str) -> VoxelSet:
        """Return the region, a ball in the middle."""
        return ball(self.grid, Pose.from_euler((0, 0, 0), (0, 0, 0)), self.region_mm)

    part = region
    body: Any = region  # of figures that this benchmark does not ask for

    def figure(self, seed: int, scans: int) -> dict[str, float]:
        """Return the figure of a few scans."""

        def again(signal: Any, centres_mm: np.ndarray, scans: int) -> Repeated:
            without = [self.make(None, [seed, scan]) for scan in range(scans)]
            return Repeated(without, self.make(centres_mm, [seed, 0]))

        at = Measurement(self, self.make(None, [seed, 0]), self.truth, 1.0, again=again)
        return TASKS.measured(
            at, DetectionTask(name="task", signal=self.signal, region="region", scans=scans)
        )

    def ensemble(self, scans: int) -> tuple[float, float, float]:
        """Return d', d' in quantum noise alone, and the standard error of the latter, relative."""
        edge, half = (
            float(self.grid.voxel[0]),
            round(2 * self.signal.radius_mm / self.grid.voxel[0]),
        )
        index = np.argwhere(self.depth() > self.signal.radius_mm)
        far = np.abs(index - np.array(self.grid.shape) // 2).max(axis=1)
        spots = np.array([i for i in index if (i % (2 * half) == 0).all()])[:8]
        offsets = np.random.default_rng(99).uniform(-0.5, 0.5, (_SHIFTS, *spots.shape))
        centres = (spots + offsets)[:, :, ::-1] * edge + self.grid.first_voxel_mm
        boxes = [tuple(slice(i - half, i + half + 1) for i in spot) for spot in spots]
        axis = np.arange(-half, half + 1) * edge
        z, y, x = np.meshgrid(axis, axis, axis, indexing="ij")
        seen = z * z + y * y + x * x <= (2 * self.signal.radius_mm) ** 2
        empty, full = [], []  # (scans, spots, voxels)
        mean = np.zeros(self.grid.shape)
        for scan in range(scans):
            # Equal noise in both: noise in the template would count as signal.
            one = self.make(None, [1000, scan]) - self.truth
            two = self.make(centres[scan % _SHIFTS], [1000, scan]) - self.truth
            mean += one / scans
            empty.append([one[box][seen] for box in boxes])
            full.append([two[box][seen] for box in boxes])
        absent, present = np.array(empty, np.float64), np.array(full, np.float64)
        template = present.mean(axis=(0, 1)) - absent.mean(axis=(0, 1))
        without, with_signal = absent @ template, present @ template
        raised = with_signal.mean() - without.mean()
        quantum = without.var(axis=0, ddof=1).mean()
        present_too = with_signal.var(axis=0, ddof=1).mean()  # with shift
        kernel = np.zeros(seen.shape)
        kernel[seen] = template
        responses = ndimage.correlate(mean, kernel, mode="constant")
        inside = index[far < min(self.grid.shape) // 2 - half]
        texture = responses[tuple(inside.T)].var() - quantum / scans
        variance = (quantum + present_too) / 2 + texture
        error = 1 / np.sqrt(2 * scans * len(spots))
        return raised / np.sqrt(variance), raised / np.sqrt(quantum), error

    def depth(self) -> np.ndarray:
        """Return the distance of the region's voxels from its border, mm."""
        region = self.region("region")
        mask = np.zeros(self.grid.shape, np.bool_)
        mask[region.box][region.mask] = True
        return ndimage.distance_transform_edt(mask, sampling=self.grid.voxel[::-1].tolist())


def degraded() -> dict[str, Case]:
    """Return eight ways to make a volume of white noise worse."""
    grid = VolumeGrid((64,) * 3, 1.0)
    signal = SphereSignal(kind="sphere", radius_mm=3, contrast_rel=0.05)
    z, y, x = grid.axes()[::-1]

    def marked(centres: np.ndarray | None) -> np.ndarray:
        out = np.zeros(grid.shape)
        for cx, cy, cz in () if centres is None else centres:
            near = (z[:, None, None] - cz) ** 2 + (y[:, None] - cy) ** 2 + (x - cx) ** 2
            out += contrast_at(signal, np.sqrt(near), 1.0)
        return out

    def case(then: Any = lambda v: v, noise: float = 0.05, share: float = 1.0) -> Case:
        def make(centres: np.ndarray | None, key: list[int]) -> np.ndarray:
            drawn = noise * np.random.default_rng(key).standard_normal(grid.shape)
            return then(share * marked(centres) + drawn).astype(np.float32)

        return Case(grid, np.zeros(grid.shape, np.float32), 25.0, signal, make)

    cases = {"noise": case(), "twice the noise": case(noise=0.1)}
    cases |= {f"blur {s}": case(lambda v, s=s: ndimage.gaussian_filter(v, s)) for s in (1, 2, 3)}
    cases["median of 3^3"] = case(lambda v: ndimage.median_filter(v, 3))
    cases["half the contrast"] = case(share=0.5)
    cases["shift of a voxel"] = case(lambda v: np.roll(v, 1, axis=(0, 1, 2)))
    return cases


PHOTONS = 6e5
"""Photons of a pixel in the free beam, in all views together."""


def paths() -> dict[str, Case]:
    """Return circles of few and many views, with equal photons in all."""
    grid, panel = VolumeGrid((48,) * 3, 2.0), Panel(64, 64, 3.5, 3.5)
    signal = SphereSignal(kind="sphere", radius_mm=5, contrast_rel=0.05)
    mu = 0.02
    water = SphereSignal(kind="sphere", radius_mm=46, contrast_rel=1.0)
    bone = SphereSignal(kind="sphere", radius_mm=5, contrast_rel=1.5)
    rods = np.array([[36.0, 0, 0], [-30, 18, 6], [0, -36, -6], [10, 34, 3]])
    middle = np.zeros((1, 3))
    axis = grid.axes()[0]
    radius = np.sqrt(axis[:, None, None] ** 2 + axis[:, None] ** 2 + axis**2)
    truth = (mu * contrast_at(water, radius, 2.0)).astype(np.float32)

    def case(views: int) -> Case:
        geometry = commanded_views(CircleTrajectory(kind="circle", views=views), panel)

        def integrals(body: SphereSignal, centres: np.ndarray) -> np.ndarray:
            rays = Insertion(Inserts(body, centres, mu))
            images = [rays.attenuation(geometry[view], 4) for view in range(views)]
            shape = views, panel.rows, 4, panel.columns, 4
            return np.array(images).reshape(shape).mean(axis=(2, 4))

        projector = Projector(geometry, grid)
        background = integrals(water, middle) + integrals(bone, rods)
        known: dict[bytes, np.ndarray] = {}

        def make(centres: np.ndarray | None, key: list[int]) -> np.ndarray:
            exact = background
            if centres is not None:
                name = centres.tobytes()
                if name not in known:
                    known[name] = integrals(signal, centres)
                exact = background + known[name]
            # Of a large number of photons, Poisson's noise is normal; drawn so, it is equal with
            # and without the signal for one key.
            sigma = np.sqrt(np.exp(background) * views / PHOTONS)
            noise = sigma * np.random.default_rng(key).standard_normal(exact.shape)
            return fdk(projector, (exact + noise).astype(np.float32), window="hann").array

        return Case(grid, truth, 24.0, signal, make)

    return {f"{views} views": case(views) for views in (30, 60, 120)}


def main() -> None:
    """Measure all cases that the folder lacks, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--ensemble", type=int, default=200)
    parser.add_argument("--scans", type=int, default=USUAL_SCANS)
    parser.add_argument("--only", choices=["degraded", "paths"])
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    kinds = {"degraded": degraded, "paths": paths}
    for kind, cases in kinds.items():
        if options.only not in (None, kind):
            continue
        print(f"{kind:20}  ensemble (quantum)  few-seed figure, lowest to highest   worst   inside")
        for name, case in cases().items():
            file = options.out / f"{name.replace(' ', '-').replace('^', '')}.json"
            if not file.exists():
                start = time.perf_counter()
                true, quantum, error = case.ensemble(options.ensemble)
                few = [case.figure(seed, options.scans) for seed in range(options.seeds)]
                seconds = time.perf_counter() - start
                found = {"true": true, "quantum": quantum, "error": error, "few": few}
                file.write_text(json.dumps(found | {"seconds": seconds}))
            data = json.loads(file.read_text())
            values = [one["detectability"] for one in data["few"]]
            alone = [one["detectability_quantum"] for one in data["few"]]
            worst, of_alone = (
                max(abs(v / true - 1) for v in some)
                for some, true in ((values, data["true"]), (alone, data["quantum"]))
            )
            held = sum(
                one["detectability_low"] < data["true"] < one["detectability_high"]
                for one in data["few"]
            )
            print(
                f"{name:20}  {data['true']:6.2f} ({data['quantum']:6.2f})   "
                f"{min(values):6.2f} to {max(values):6.2f} (quantum {min(alone):6.2f} to "
                f"{max(alone):6.2f})  {100 * worst:4.1f} % ({100 * of_alone:4.1f} %)  "
                f"{held} of {len(values)}  {data['seconds']:.0f} s",
                flush=True,
            )


if __name__ == "__main__":
    main()
