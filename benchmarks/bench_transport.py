"""Photon transport: bricks, a screw in a head, energy, and scatter between simulated views.

python benchmarks/bench_transport.py screw
python benchmarks/bench_transport.py bricks
python benchmarks/bench_transport.py energy
python benchmarks/bench_transport.py threads
python benchmarks/bench_transport.py views --views 16 --photons 5e5 --judge 2e6 --pixel 40

``screw``: processor seconds of a photon in a head of 256^3 voxels with a titanium screw, relative
to the head alone, in turns. ``bricks``: that time with bricks of other sizes. ``energy``: what the
photons of a batch bring, against what they deposit and take away. ``threads``: the time of one
thread relative to that of two in a block of brain, in turns; the shortest of each, as other work
disturbs them.
``views``: scatter of a view between simulated ones, against that view with more photons, RMS
relative to its mean; the built-in head, a circle of 200 views, 80 keV.
"""

from __future__ import annotations

import argparse
import time
from unittest import mock

import numba
import numpy as np

from twinct.core.threads import let_idle_threads_sleep
from twinct.geometry import VolumeGrid
from twinct.scenario import Detector as DetectorSection
from twinct.scenario import Source, Specimen
from twinct.specimen import build_specimen
from twinct.specimen.materials import material
from twinct.trajectory import CircleTrajectory, commanded_views
from twinct.transport import Beam, Simulation, VoxelBody, voxel_body
from twinct.xray.build import build_beam, build_response
from twinct.xray.monte_carlo_scatter import scatter_of
from twinct.xray.sections import MonteCarloScatter

PHOTONS, ROUNDS, PAIRS = 300_000, 3, 100
MATERIALS = {n: material(name) for n, name in enumerate(("air", "brain", "bone", "titanium"))}
BEAM = Beam(
    (-600, 0, 0),
    (600, 0, 0),
    (0, 200, 0),
    (0, 0, 150),
    np.arange(30, 120.0, 2),
    np.linspace(2, 0.2, 45),
)
BETWEEN = 57, 103, 161
"""Views that are judged; none is simulated among 16 or 20 of 200."""


def labels(screw: bool) -> tuple[VolumeGrid, np.ndarray]:
    """Return a head of brain and bone, perhaps with a screw of 5 mm in its side."""
    grid = VolumeGrid((256, 256, 256), 0.9)
    x, y, z = grid.axes()[0], grid.axes()[1][:, None], grid.axes()[2][:, None, None]
    radius = np.sqrt((x / 80) ** 2 + (y / 95) ** 2 + (z / 105) ** 2)
    made = np.zeros(grid.shape, np.uint8)
    made[radius < 1], made[radius < 0.92] = 2, 1
    if screw:
        made[np.broadcast_to((abs(x) < 20) & (np.hypot(y - 80, z) < 2.5), made.shape)] = 3
    return grid, made


def head(screw: bool = False) -> Simulation:
    """Return the simulation of a head, compiled."""
    simulation = Simulation(VoxelBody.of_labels(*labels(screw), MATERIALS), BEAM, dose=False)
    simulation.run(10, 1)
    return simulation


def seconds(simulation: Simulation) -> float:
    """Return processor seconds of a million photons."""
    clock = time.process_time()
    simulation.run(PHOTONS, 1)
    return (time.process_time() - clock) / PHOTONS * 1e6


def screw() -> None:
    """Print the times without and with a screw."""
    both = head(), head(screw=True)
    times = np.array([[seconds(one) for one in both] for _ in range(ROUNDS)])
    each = ", ".join(f"{without:.2f} and {within:.2f}" for without, within in times)
    print(f"s for a million photons, without and with the screw: {each}")
    print(f"ratio of the medians: {np.divide(*np.median(times, axis=0)[::-1]):.2f}")


def bricks() -> None:
    """Print the times of bricks of several sizes."""
    for edge in (4, 8, 16, 32):
        with mock.patch.object(voxel_body, "BRICK", edge):
            simulation = head()
            found = np.median([seconds(simulation) for _ in range(ROUNDS)])
            print(f"bricks of {edge}^3 voxels: {found:.2f} s for a million photons", flush=True)


def energy() -> None:
    """Print the largest imbalance of a batch's energy."""
    body = VoxelBody.of_labels(*labels(screw=True), MATERIALS)
    print(f"largest imbalance of a batch: {Simulation(body, BEAM).run(20_000, 10).imbalance:.1e}")


def threads() -> None:
    """Print the shortest times with one and two threads, of many short runs in turns."""
    grid = VolumeGrid((64, 64, 64), 3.5)
    body = VoxelBody.of_labels(grid, np.ones(grid.shape, int), MATERIALS)
    simulation = Simulation(body, BEAM, dose=False)
    simulation.run(10, 1)
    walls, busy = np.zeros((2, PAIRS, 2))
    for pair in range(PAIRS):
        for n in range(2):
            numba.set_num_threads(n + 1)
            wall, processor = time.perf_counter(), time.process_time()
            simulation.run(PHOTONS // 20, 4)
            walls[pair, n] = time.perf_counter() - wall
            busy[pair, n] = time.process_time() - processor
    for name, (one, two) in (("shortest", walls.min(axis=0)), ("median", np.median(walls, axis=0))):
        print(f"{name} of {PAIRS}: {one:.3f} and {two:.3f} s, {one / two:.2f} x")
    one, two = np.median(busy, axis=0)
    print(f"processor time with two threads: {two / one:.3f} x that with one")


def views(simulated: int, photons: int, judge: int, pixel_mm: float) -> None:
    """Print how far interpolated scatter is from that of single views."""
    source = Source.model_validate({"energy_kev": 80.0})
    panel = {"rows": 120, "columns": 160, "pixel_pitch_mm": 2.5}
    detector = DetectorSection.model_validate(panel)
    part = {"shape": {"kind": "volume", "phantom": "head"}}
    specimen = build_specimen(Specimen.model_validate({"parts": [part]}))
    circle = CircleTrajectory(kind="circle", views=200, sod_mm=600, sdd_mm=1000)
    geometry = commanded_views(circle, detector.panel)
    scene = specimen, build_beam(source), build_response(detector), None, detector.panel, geometry
    kind = "monte_carlo"
    of_few = {"photons": photons, "views": simulated, "pixel_mm": pixel_mm}
    few = scatter_of(MonteCarloScatter(kind=kind, **of_few), *scene)
    own = scatter_of(MonteCarloScatter(kind=kind, photons=judge, views=200), *scene)
    seen = specimen.world_from_specimen.inverse() @ geometry
    for view in BETWEEN:
        between, alone = few.image(seen[view]), own.image(seen[view])
        off = np.sqrt(np.mean((between - alone) ** 2)) / alone.mean()
        print(
            f"view {view}: RMS {off:.1%}, mean {between.mean() / alone.mean() - 1:+.1%}", flush=True
        )


def main() -> None:
    """Measure one of them."""
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n", maxsplit=1)[0])
    parser.add_argument("what", choices=("screw", "bricks", "energy", "threads", "views"))
    parser.add_argument("--views", type=int, default=16)
    parser.add_argument("--photons", type=float, default=5e5)
    parser.add_argument("--judge", type=float, default=2e6)
    parser.add_argument("--pixel", type=float, default=20.0, help="edge of the coarse pixels, mm")
    given = parser.parse_args()
    let_idle_threads_sleep()
    if given.what == "views":
        views(given.views, int(given.photons), int(given.judge), given.pixel)
    else:
        {"screw": screw, "bricks": bricks, "energy": energy, "threads": threads}[given.what]()


if __name__ == "__main__":
    main()
