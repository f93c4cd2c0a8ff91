"""Scans of the zoo: objects, trajectories, spectra and noise, each drawn from a seed."""

from dataclasses import dataclass

import numpy as np
import zoo_objects as objects
import zoo_shapes
from scipy import ndimage

from twinct.evaluation import region_of_interest
from twinct.geometry import Panel, Pose, ScanGeometry, VolumeGrid
from twinct.recon import Projector
from twinct.recon.few_photons import integrals_of_photons
from twinct.specimen.materials import Material

SPAN_MM = 64.0
"""Edge of the grid."""
SOD_MM, SDD_MM = 400.0, 600.0
SAMPLES = 2
"""Rays along each edge of a pixel; their intensities are averaged."""
FINE = 5
"""Samples of the truth along each edge of a voxel, at 48 voxels; the truth is not a sample of A."""
NEAR_MM = 3.0
MONO_KEV = 60.0
TUBE_KV, FILTER_MM = 110.0, 0.5
"""Voltage of the tube, and thickness of its copper filter."""

_BONE = {"H": 0.034, "C": 0.155, "N": 0.042, "O": 0.435, "Mg": 0.003, "P": 0.103, "Ca": 0.228}
MATERIALS = {
    "air": Material("air", 0.0012, {"N": 0.76, "O": 0.24}),
    "polymer": Material("polymer", 1.19, {"H": 0.081, "C": 0.6, "O": 0.319}),
    "laminate": Material("laminate", 1.85, {"H": 0.03, "C": 0.27, "O": 0.4, "Si": 0.3}),
    "mould": Material("mould", 1.9, {"H": 0.02, "C": 0.2, "O": 0.45, "Si": 0.33}),
    "teflon": Material("teflon", 2.2, {"C": 0.24, "F": 0.76}),
    "water": Material("water", 1.0, {"H": 0.112, "O": 0.888}),
    "fat": Material("fat", 0.95, {"H": 0.114, "C": 0.598, "N": 0.007, "O": 0.281}),
    "muscle": Material("muscle", 1.05, {"H": 0.102, "C": 0.143, "N": 0.034, "O": 0.721}),
    "marrow": Material("marrow", 1.0, {"H": 0.11, "C": 0.53, "N": 0.02, "O": 0.34}),
    "spongy": Material("spongy", 1.18, {"H": 0.085, "C": 0.4, "N": 0.028, "O": 0.367, "P": 0.12}),
    "bone": Material("bone", 1.85, _BONE),
    "dentine": Material("dentine", 2.1, _BONE),
    "enamel": Material("enamel", 2.9, {"H": 0.01, "O": 0.43, "P": 0.18, "Ca": 0.38}),
    "aluminium": Material("aluminium", 2.7, {"Al": 1.0}),
    "titanium": Material("titanium", 4.5, {"Ti": 1.0}),
    "copper": Material("copper", 8.96, {"Cu": 1.0}),
    "solder": Material("solder", 7.4, {"Sn": 0.965, "Ag": 0.03, "Cu": 0.005}),
}
METALS = ("titanium", "copper", "solder")
"""Left out of the judged voxels, and of the reference."""


@dataclass(frozen=True)
class Case:
    """One scan of the zoo.

    Attributes:
        name: unique.
        draw: function of a generator that returns the shapes.
        path: name of a trajectory.
        views: number of views.
        photons: free-beam photons of a pixel; None: no noise.
        size: voxels along an edge.
        main: material by which a polychromatic scan is linearised; None: monochromatic.
        truncated: the object is larger than the grid.
    """

    name: str
    draw: object
    path: str
    views: int
    photons: float | None
    size: int = 48
    main: str | None = None
    truncated: bool = False


TUNING = (
    Case("foam", objects.foam, "circle", 60, 1e4),
    Case("sheets", objects.sheets, "sphere", 48, 3e3),
    Case("tissue", objects.tissue, "circle", 120, 3e3),
    Case("casting", objects.casting, "helix", 90, 1e4, main="aluminium"),
    Case("board", objects.board, "arc", 100, 1e5, 64, main="laminate"),
    Case("spine", objects.spine, "arcs", 60, 1e4, 64, main="water", truncated=True),
    Case("tooth", objects.tooth, "cap", 100, None, 64),
    Case("gradients", objects.gradients, "saddle", 40, 1e3),
    Case("limb", objects.limb, "circle", 60, 1e4, truncated=True),
    Case("trabecular, dim", objects.trabecular, "circle", 400, 300.0),
)
THIN = (
    Case("lattice", objects.lattice, "circle", 90, 1e5),
    Case("balls", objects.balls, "sphere", 60, 3e4),
    Case("walls", objects.walls, "helix", 100, None),
    Case("lattice, dim", objects.lattice, "cap", 120, 1e3),
    Case("balls, few", objects.balls, "saddle", 30, 1e5),
)
"""Thin parts in air, for tuning as well; zoo.py takes them with --thin."""
HELD_OUT = (
    Case("foam, dim", objects.foam, "arcs", 40, 300.0),
    Case("wires", objects.wires, "circle", 60, 1e4),
    Case("thin wires", objects.thin_wires, "sphere", 100, 1e5),
    Case("sheets, no noise", objects.sheets, "helix", 60, None),
    Case("tissue, dim", objects.tissue, "cap", 200, 1e3),
    Case("casting, dim", objects.casting, "circle", 300, 300.0, main="aluminium"),
    Case("board, few", objects.board, "saddle", 50, 1e4, 64, main="laminate"),
    Case("spine, bright", objects.spine, "circle", 120, 1e5, 64, main="water", truncated=True),
    Case("foot", objects.foot, "arc", 80, 3e3, main="water"),
    Case("mixture", objects.mixture, "sphere", 30, 1e4),
    Case("trabecular", objects.trabecular, "cap", 90, 1e4, 64),
    Case("trunk", objects.trunk, "helix", 120, 3e4, truncated=True),
)


def sources(path, views, rng):
    """Return unit vectors from the isocentre to the source, (views, 3)."""
    share = (np.arange(views) + rng.uniform()) / views
    longitude, latitude = 2 * np.pi * share, np.zeros(views)
    if path == "arc":
        longitude = np.radians(210 * share)
    elif path == "arcs":  # two arcs in orthogonal planes
        angle = np.radians(200) * (2 * share % 1) - np.radians(100)
        flat = np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
        upright = np.stack([np.cos(angle), 0 * angle, np.sin(angle)], 1)
        return np.where((share < 0.5)[:, None], flat, upright)
    elif path == "sphere":
        latitude = np.arcsin(rng.uniform(-1, 1, views))
        longitude = 2 * np.pi * rng.uniform(size=views)
    elif path == "cap":  # random directions within 65 degrees of the equator, on one side
        latitude = np.arcsin(np.sin(np.radians(65)) * rng.uniform(-1, 1, views))
        longitude = np.radians(200) * rng.uniform(size=views)
    elif path == "saddle":
        latitude = np.radians(30) * np.sin(2 * longitude)
    elif path == "helix":
        longitude = 4 * np.pi * share
    across = np.cos(latitude)
    return np.stack([across * np.cos(longitude), across * np.sin(longitude), np.sin(latitude)], 1)


def geometry_of(case, size, rng):
    """Return the views, with pixels as large as a voxel at the isocentre."""
    way = sources(case.path, case.views, rng)
    shift = np.zeros((case.views, 3))
    if case.path == "helix":
        shift[:, 2] = np.linspace(-12, 12, case.views)
    upward = np.where(np.abs(way[:, 2:]) > 0.99, [1.0, 0, 0], [0, 0, 1.0])
    u = np.cross(upward, way)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    pitch, pixels = SPAN_MM / size * SDD_MM / SOD_MM, int(1.5 * size)
    panel = Panel(pixels, pixels, pitch, pitch)
    far = shift - (SDD_MM - SOD_MM) * way
    return ScanGeometry(shift + SOD_MM * way, far, u, np.cross(way, u), panel)


def spectrum(main):
    """Return energies, keV, and weights of the detected signal, and the energy of the volume.

    Kramers's law, filtered by copper; the detector adds up energy.
    """
    if main is None:
        return np.array([MONO_KEV]), np.ones(1), MONO_KEV
    energies = np.arange(22.5, TUBE_KV, 5.0)
    copper = np.array([MATERIALS["copper"].mu_per_mm(e) for e in energies])
    weights = (TUBE_KV / energies - 1) * np.exp(-FILTER_MM * copper) * energies
    weights /= weights.sum()
    return energies, weights, float(weights @ energies)


class Made:
    """One scan with its truth.

    Attributes:
        A: projector of the grid.
        p: line integrals with noise, linearised if polychromatic.
        raw: line integrals as measured.
        counts: photons of each pixel; None without noise.
        truth: attenuation, 1/mm.
        mu: attenuation of the densest material that is no metal.
        metal: voxels that hold metal.
        near: voxels that are judged.
    """

    def __init__(self, case, seed, size=None):
        """Draw shapes, views and noise."""
        self.case, self.size = case, size or case.size
        rng = np.random.default_rng([seed, *case.name.encode()])
        self.shapes = case.draw(rng)
        self.names = sorted({shape.material for shape in self.shapes})
        voxel = SPAN_MM / self.size
        self.grid = VolumeGrid((self.size,) * 3, np.full(3, voxel), Pose.identity())
        self.geometry = geometry_of(case, self.size, rng)
        self.energies, self.weights, energy = spectrum(case.main)
        self.mu_of = {name: MATERIALS[name].mu_per_mm(energy) for name in self.names}
        self._judge()
        self.counts, self.raw = self._projections(rng)
        self.p = self.raw if case.main is None else self._linearised(self.raw)
        self.A = Projector(self.geometry, self.grid)

    def _judge(self):
        fine = max(2, round(FINE * 48 / self.size))
        shares = zoo_shapes.fractions(self.shapes, self.names, self.grid, fine)
        mus = np.array([self.mu_of[name] for name in self.names], np.float32)
        self.truth = np.tensordot(mus, shares, axes=1)
        self.metal = np.zeros(self.grid.shape, bool)
        for name, share in zip(self.names, shares, strict=True):
            self.metal |= (share > 0) & (name in METALS)
        self.mu = max(mu for name, mu in self.mu_of.items() if name not in METALS)
        far = ndimage.distance_transform_edt(self.truth < 0.1 * self.mu) * self.grid.voxel[0]
        seen = region_of_interest(self.geometry, self.grid)
        self.near = (far <= NEAR_MM) & seen & ~self.metal

    def _paths(self):
        """Yield each view's path lengths, (materials, rows * columns * samples^2)."""
        panel, arrays = self.geometry.panel, zoo_shapes.packed(self.shapes, self.names)
        offsets = (np.arange(SAMPLES * panel.columns) + 0.5) / SAMPLES - panel.columns / 2
        for view in self.geometry:
            across = offsets[None, :, None] * panel.pitch_u * view.u[0]
            up = offsets[:, None, None] * panel.pitch_v * view.v[0]
            to = (view.detector[0] + across + up).reshape(-1, 3) - view.source[0]
            to /= np.linalg.norm(to, axis=1, keepdims=True)
            lengths = np.zeros((len(self.names), len(to)))
            zoo_shapes.path_lengths(view.source[0].copy(), to, *arrays, lengths)
            yield lengths

    def _projections(self, rng):
        panel, photons = self.geometry.panel, self.case.photons
        mus = [[MATERIALS[name].mu_per_mm(e) for name in self.names] for e in self.energies]
        shape = panel.rows, SAMPLES, panel.columns, SAMPLES
        light = np.array(
            [
                (self.weights @ np.exp(-np.array(mus) @ lengths)).reshape(shape).mean((1, 3))
                for lengths in self._paths()
            ]
        )
        counts = None
        if photons is not None:
            counts = rng.poisson(photons * light)
            # As the chain does it: no pixel has less than half a photon.
            light = np.maximum(counts, 0.5) / photons
        p = -np.log(light) if photons is None else integrals_of_photons(light, photons)
        return counts, p.astype(np.float32)

    def _linearised(self, p):
        """Return the line integrals at one energy, as if all was of the main material."""
        main = MATERIALS[self.case.main]
        lengths = np.concatenate([np.linspace(0, 100, 500), np.geomspace(101, 1e4, 100)])
        mus = np.array([main.mu_per_mm(e) for e in self.energies])
        poly = -np.log(self.weights @ np.exp(-np.outer(mus, lengths)) + 1e-300)
        _, _, energy = spectrum(self.case.main)
        slope = main.mu_per_mm(energy)
        below = np.minimum(p, 0) * slope / float(self.weights @ mus)
        found = np.where(p < 0, below, np.interp(p, poly, slope * lengths))
        return found.astype(np.float32)

    def error(self, volume):
        """Return the RMSE near the object, % of the mu of the densest non-metal."""
        square = np.square((volume - self.truth)[self.near], dtype=np.float64)
        return 100 * float(np.sqrt(square.mean())) / self.mu
