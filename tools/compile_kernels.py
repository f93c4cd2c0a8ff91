"""Compile every kernel of twinct into its cache, so that tests and first runs need not compile.

    python tools/compile_kernels.py

``make setup`` calls this script. Three processes compile in parallel: each kernel of the plain
engine has one cache beside its source and another one below the cache of the vector engine, and
Warp keeps the kernels of a card in its own. Each finished group of kernels is counted in one line
of the terminal; without a terminal, each has a line of its own.
"""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import threading
import time

import numpy as np

DONE = "compiled: "
"""Beginning of the line by which a process reports a finished group of kernels."""

STILL_S = 15
"""Without news for so many seconds, a line says that the work goes on."""


def main() -> int:
    """Compile one part, or each part in its own process, and return the exit code."""
    logging.getLogger("twinct").setLevel(logging.ERROR)  # make setup has announced the compilation
    if len(sys.argv) > 1:
        for name, compile_group in PARTS[sys.argv[1]].items():
            compile_group()
            sys.stdout.write(f"{DONE}{name}\n")
            sys.stdout.flush()
        return 0
    progress = Progress()
    workers = [
        subprocess.Popen(
            [sys.executable, __file__, part],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE if part == "card" else None,
            text=True,
        )
        for part in PARTS
    ]
    listeners = [threading.Thread(target=progress.follow, args=(one.stdout,)) for one in workers]
    for listener in listeners:
        listener.start()
    progress.until_end_of(listeners)
    codes = [worker.wait() for worker in workers]
    if codes[-1] and (told := workers[-1].stderr):  # else Warp only says that there is no card
        sys.stderr.write(told.read())
    return max(codes)


class Progress:
    """Count of the finished groups of kernels, on the terminal or in lines."""

    def __init__(self) -> None:
        """Begin with none."""
        self._all = sum(map(len, PARTS.values()))
        self._done, self._start = 0, time.monotonic()
        self._news = threading.Event()
        self._lock = threading.Lock()

    def follow(self, lines) -> None:
        """Count what a process reports."""
        for line in lines:
            if line.startswith(DONE):
                with self._lock:
                    self._done += 1
                    self._say(f"{self._done} of {self._all}: {line[len(DONE) :].strip()}")
                    self._news.set()

    def until_end_of(self, threads) -> None:
        """Wait for threads, and say from time to time that the work goes on."""
        told = time.monotonic()
        while any(thread.is_alive() for thread in threads):
            if self._news.wait(0.2):
                self._news.clear()
                told = time.monotonic()
            if time.monotonic() - told > STILL_S:
                told = time.monotonic()
                with self._lock:
                    self._say(f"{self._done} of {self._all}: still compiling")
        if sys.stdout.isatty():
            sys.stdout.write("\r\033[K")

    def _say(self, words: str) -> None:
        words = f"  {words} ({time.monotonic() - self._start:.0f} s)"
        sys.stdout.write(f"\r\033[K{words}" if sys.stdout.isatty() else f"{words}\n")
        sys.stdout.flush()


def _plain_alone() -> None:
    os.environ["TWINCT_ENGINE"] = "plain"
    _reconstruct("plain")


def _skull() -> None:
    from twinct.specimen.skull import skull_surface

    skull_surface()  # kept on disk for later processes


def _card() -> None:
    """Compile the kernels of a card for the processor, on which the tests run them."""
    from twinct.core.card import DEVICE_VARIABLE

    os.environ[DEVICE_VARIABLE] = "cpu"
    _reconstruct("cuda")


def _card_mesh() -> None:
    from twinct.xray.cuda_mesh import CudaMeshEngine

    _expose_mesh(CudaMeshEngine())


def _reconstruct(engine: str) -> None:
    """Call every kernel of an engine through the algorithms that use it."""
    from twinct.geometry import Panel, Pose, VolumeGrid
    from twinct.recon import Projector, fast, fdk, sart
    from twinct.recon.moving import MovingProjector
    from twinct.recon.ray_slopes import pose_gradient
    from twinct.specimen.deformation import Deformation
    from twinct.trajectory import CircleTrajectory, commanded_views

    circle = CircleTrajectory(kind="circle", views=4, sod_mm=200, sdd_mm=400)
    geometry = commanded_views(circle, Panel(8, 9, 10.0, 10.0))
    projector = Projector(geometry, VolumeGrid((6, 7, 8), 8.0), engine=engine)
    projections = projector(np.ones(projector.domain_shape, np.float32))
    projector.T(projections)
    sart(projector, projections, iterations=1, relaxation=0.5)
    fast(projector, projections)
    fdk(projector, projections)
    if engine == "cuda":
        return
    pose_gradient(projector, np.ones(projector.domain_shape, np.float32), projections)
    still = Deformation(np.zeros_like, Pose.identity())
    moving = MovingProjector(geometry, projector.grid, [still] * 4, engine)
    moving.T(moving(np.ones(moving.domain_shape, np.float32)))


def _transport() -> None:
    from twinct.geometry import Panel, ScanGeometry, VolumeGrid
    from twinct.specimen.materials import material
    from twinct.transport import AntiScatterGrid, Beam, Detector, Simulation, VoxelBody
    from twinct.transport._angles import scatter_compton, scatter_rayleigh
    from twinct.transport._flight import fly

    source, detector = np.array([[0.0, 0.0, 100.0]]), np.array([[0.0, 0.0, -100.0]])
    u, v = np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 1.0, 0.0]])
    geometry = ScanGeometry(source, detector, u, v, Panel(2, 2, 50.0, 50.0))
    grid = VolumeGrid((2, 2, 2), 10.0)
    body = VoxelBody.of_labels(grid, np.zeros(grid.shape, np.uint8), {0: material("water")})
    simulation = Simulation(body, Beam.of_view(geometry, 0, 60.0), detector=Detector(geometry))
    simulation.run(1, 1)
    simulation.primary()
    simulation.primary_energy()
    strips = material("lead"), material("aluminium")
    AntiScatterGrid("u", 10.0, 0.25, 0.05, *strips).transmission(np.array([60.0]), 0.0, 0.0)
    # Called one by one in the tests of their distributions.
    voxels, media = body.tables()
    scores = np.zeros(1), np.zeros((0, 0, 0)), False
    scatter_compton(np.uint64(1), media, 0, 60.0)
    scatter_rayleigh(np.uint64(1), media, 0, 60.0)
    fly(np.uint64(1), 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0, 0.0, voxels, media, scores)


def _specimen():
    """Return a specimen of a bone ball and a titanium ball."""
    from twinct.scenario import Specimen
    from twinct.specimen import build_specimen

    ball = {"kind": "sphere", "radius_mm": 20}
    screw = {"shape": {"kind": "sphere", "radius_mm": 4}, "material": "titanium"}
    return build_specimen(Specimen.model_validate({"parts": [{"shape": ball}, screw]}))


def _voxelise() -> None:
    from twinct.geometry import Pose, VolumeGrid
    from twinct.specimen.grey_part import add_means
    from twinct.specimen.preview import shaded
    from twinct.specimen.voxels import volume_fractions

    specimen, grid = _specimen(), VolumeGrid((4, 5, 6), 10.0)
    specimen.truth(grid, 80.0)
    mesh = specimen.parts[0].mesh
    for writable in (True, False):  # numba compiles each as its own type
        faces = np.array(mesh.faces, np.int64)
        faces.setflags(write=writable)
        volume_fractions(mesh.vertices, faces, grid, Pose.identity())
    shaded(specimen, 0.0, 0.0, pixel_mm=5.0)
    field, means = np.ones((3, 3, 3), np.float32), np.zeros((4, 5, 6), np.float32)
    for pose in (Pose.identity(), Pose.from_euler((0, 0, 0), (10, 20, 30))):
        add_means(field, VolumeGrid((3, 3, 3), 9.0), grid, pose, means)


def _move() -> None:
    from twinct.geometry import Pose, VolumeGrid
    from twinct.recon.moving import map_of
    from twinct.specimen import _moved_voxels
    from twinct.specimen.deformation import Deformation

    still, grid = Deformation(np.zeros_like, Pose.identity()), VolumeGrid((4, 5, 6), 10.0)
    places = map_of(still, grid, "to_reference", 2)
    amounts, labels = np.zeros((*grid.shape, 1), np.float32), np.zeros(grid.shape, np.uint16)
    for fixed in (amounts, labels):
        fixed.setflags(write=False)
    _moved_voxels.pull_amounts(amounts, *places, np.empty_like(amounts))
    _moved_voxels.pull_labels(labels, *places, np.empty_like(labels))


def _interpolate() -> None:
    from twinct.geometry import VolumeGrid
    from twinct.recon.resolution import interpolated

    coarse = VolumeGrid((2, 3, 4), 2.0)
    interpolated(np.ones(coarse.shape, np.float32), coarse, VolumeGrid((4, 5, 6), 1.0))


def _paint() -> None:
    from twinct.geometry import VolumeGrid
    from twinct.specimen.implicit import ball
    from twinct.specimen.organs import Organ
    from twinct.specimen.phantom import Phantom

    body = Phantom((Organ("ball", 40.0, (ball((0, 0, 0), 5.0),)),))
    body.on(VolumeGrid((4, 5, 6), 2.0))
    body.at(np.zeros((2, 3)))


def _cast_shadows() -> None:
    from twinct.geometry import Panel, Pose
    from twinct.rays import Body, Rays
    from twinct.trajectory import CircleTrajectory, commanded_views

    mesh = _specimen().parts[0].mesh
    circle = CircleTrajectory(kind="circle", views=4, sod_mm=200, sdd_mm=400)
    rays = Rays(commanded_views(circle, Panel(8, 9, 10.0, 10.0)))
    body = Body(mesh.vertices, mesh.faces)
    for slopes in (False, True):
        rays.shadow(body, Pose.identity(), 0, slopes=slopes)


def _cross() -> None:
    from twinct.geometry import Panel, Pose, ScanGeometry, VolumeGrid
    from twinct.specimen import GreyField, GreyPart
    from twinct.specimen.grey_caster import GreyCaster
    from twinct.specimen.materials import material
    from twinct.xray.mesh import MeshEngine

    panel, (x, y, z) = Panel(8, 9, 10.0, 10.0), np.eye(3)[:, None]
    _expose_mesh(MeshEngine())
    grid, substance = VolumeGrid((4, 5, 6), 10.0), material("water")
    amounts = np.ones((*grid.shape, 1), np.float32)
    for sharp in (False, True):
        field = GreyField((substance,), amounts, grid, sharp)
        GreyCaster(field, panel).cast(ScanGeometry(200 * x, -200 * x, y, z, panel))
        part = GreyPart("voxels", substance, _specimen().parts[0].mesh, field)
        part.add_truth(grid, 80.0, Pose.identity(), np.zeros(grid.shape, np.float32))


def _expose_mesh(engine) -> None:
    """Render a ball in front of the source, and one around it."""
    from twinct.geometry import Panel, ScanGeometry
    from twinct.xray.engine import SceneBody

    mesh, panel = _specimen().parts[0].mesh, Panel(8, 9, 10.0, 10.0)
    x, y, z = np.eye(3)[:, None]
    image = np.empty(panel.shape, np.float32)
    engine.acquire([SceneBody(np.asarray(mesh.vertices), np.asarray(mesh.faces), 0.05)], panel)
    for distance in (200.0, 10.0):
        view = ScanGeometry(distance * x, -200 * x, y, z, panel)
        engine.render(view, image)
        engine.path_lengths(view, 0, image)
    engine.release()


def _expose() -> None:
    from twinct.specimen.materials import material
    from twinct.xray.response import PhotonResponse
    from twinct.xray.signal import Signal
    from twinct.xray.spectrum import PhotonSpectrum

    photons = PhotonSpectrum(np.array([60.0, 80.0]), np.array([1.0, 1.0]))
    for names in (("bone",), ("bone", "titanium")):
        paths = np.ones((len(names), 4, 5), np.float32)
        signal = Signal(photons, [material(name) for name in names], PhotonResponse.counting())
        signal(paths, np.ones(paths.shape[1:], np.float32))


def _judge() -> None:
    from twinct.evaluation import Edges, image_figures, region_depth, rmse_by_depth
    from twinct.evaluation.edges import LEAST_POINTS
    from twinct.geometry import Panel, VolumeGrid
    from twinct.trajectory import CircleTrajectory, commanded_views

    circle = CircleTrajectory(kind="circle", views=4, sod_mm=200, sdd_mm=400)
    views, grid = commanded_views(circle, Panel(8, 9, 10.0, 10.0)), VolumeGrid((8, 8, 8), 1.0)
    region, depth = np.ones(grid.shape, np.bool_), region_depth(views, grid)
    truth = np.zeros(grid.shape, np.float32)
    truth[4:] = 1.0
    image_figures(truth, truth, region, 1.0, grid)
    rmse_by_depth(truth, truth, region, depth, 1.0)
    Edges(np.full((LEAST_POINTS, 3), 3.5), np.ones((LEAST_POINTS, 3)), np.zeros(12)).width(truth)


PARTS = {
    "vector": {  # the plain engine has a second cache below that of the vector engine
        "vector engine": lambda: _reconstruct("vector"),
        "plain engine, beside it": lambda: _reconstruct("plain"),
    },
    "rest": {
        "plain engine": _plain_alone,
        "voxels of bodies": _voxelise,
        "skull": _skull,
        "moving voxels": _move,
        "interpolation": _interpolate,
        "phantoms": _paint,
        "shadows": _cast_shadows,
        "rays through meshes and voxels": _cross,
        "detector": _expose,
        "figures": _judge,
        "photons": _transport,
    },
    "card": {"card: reconstruction": _card, "card: projections": _card_mesh},
}
"""Groups of kernels, by the process that compiles them one after the other."""


if __name__ == "__main__":
    sys.exit(main())
