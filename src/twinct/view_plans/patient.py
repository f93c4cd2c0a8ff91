"""Patient of a plan: the scenario's specimen, which represents the patient as a prior would."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twinct.core.cached import once
from twinct.core.disk_cache import made_once
from twinct.core.errors import InputError
from twinct.core.foreign_text import quoted
from twinct.geometry import Floats, Pose, ScanGeometry, VolumeGrid
from twinct.rays import Body
from twinct.recon import Projector
from twinct.recon.volume import Volume
from twinct.robots.motion import shortest_tour
from twinct.scan import SimulationBuilder
from twinct.scenario import Cell
from twinct.specimen import Material, Part, material
from twinct.trajectory import OrbitSettings
from twinct.version import __version__
from twinct.view_planning.objectives import Views
from twinct.view_plans.candidates import candidates_of, seconds_between
from twinct.xray.build import build_beam, build_response, build_spectrum, effective_energy_kev
from twinct.xray.dose import PlaceDoses
from twinct.xray.spectrum import PhotonSpectrum
from twinct.xray.view_nodes import ViewNodes

PRIOR_MM = 3.0
"""Voxel size of the patient's attenuation volume."""

PART_POINTS = 200
"""Largest number of points of a part, such as for the rays that meet it."""


@dataclass(frozen=True, eq=False)
class Patient:
    """Model of the specimen for the planning of views, see ``PatientModel``.

    Attributes:
        builder: builder of the scenario.
        voxel_mm: voxel size of the specimen's volume.
    """

    builder: SimulationBuilder
    voxel_mm: float = PRIOR_MM

    @property
    def seed(self) -> int:
        """Seed of the scenario."""
        return self.builder.scenario.seed

    @property
    def energy_kev(self) -> float:
        """Effective energy of the beam."""
        return self._energy_kev

    @cached_property
    def _energy_kev(self) -> float:
        return effective_energy_kev(self.builder.scenario.source, self.builder.scenario.detector)

    @property
    def reference_mu(self) -> float:
        """Attenuation of the reference material at the effective energy, 1/mm."""
        return self.builder.specimen.reference_mu(self.energy_kev)

    @cached_property
    def _fractions(self) -> tuple[VolumeGrid, list[tuple[Material, NDArray[np.float32]]]]:
        """Amounts of each material, on a coarse grid that holds all parts."""
        specimen = self.builder.specimen
        low, high = specimen.bounds
        pose = specimen.world_from_specimen @ Pose.from_euler((low + high) / 2, (0.0, 0.0, 0.0))
        count = np.maximum(np.ceil((high - low) / self.voxel_mm).astype(int) + 2, 2)[::-1]
        grid = VolumeGrid(count.tolist(), self.voxel_mm, pose)
        place = specimen.world_from_specimen
        return grid, [one for part in specimen.parts for one in part.shares(grid, place)]

    def attenuation(self, energy_kev: float) -> Volume:
        """See ``PatientModel``."""
        grid, fractions = self._fractions
        total = np.zeros(grid.shape, np.float32)
        for substance, share in fractions:
            total += np.float32(substance.mu_per_mm(energy_kev)) * share
        return Volume(total, grid)

    def _part(self, name: str) -> Part:
        return self.builder.specimen.named(name, "task")

    def points_of(self, part: str) -> Floats:
        """See ``PatientModel``."""
        body_part, rng = self._part(part), np.random.default_rng([self.seed, 15])
        points = body_part.points(body_part.label_of(part), PART_POINTS, rng)
        return self.builder.specimen.world_from_specimen.apply(points)

    def photons(
        self, geometry: ScanGeometry, place: Floats, voxel_mm: float, key: str
    ) -> tuple[ScanGeometry, Floats]:
        """See ``PatientModel``."""
        source, spectrum = self.builder.scenario.source, self._absolute(key)
        panel = geometry.panel
        shrink = np.linalg.norm(geometry.source - place, axis=1) / geometry.sdd_to_centre
        pixel = voxel_mm / float(shrink.mean())
        rows, columns = (max(1, int(pixel / pitch)) for pitch in (panel.pitch_v, panel.pitch_u))
        coarse = geometry.binned(min(rows, panel.rows), min(columns, panel.columns))
        prior = self.attenuation(self.energy_kev)
        depth = Projector(coarse, prior.grid)(prior.array)
        area = coarse.panel.pitch_u * coarse.panel.pitch_v
        free = spectrum.total * source.mas * area * (1000 / coarse.sdd_to_centre) ** 2
        return coarse, free[:, None, None] * np.exp(-depth)

    def _absolute(self, key: str) -> PhotonSpectrum:
        spectrum = build_spectrum(self.builder.scenario.source)
        if not spectrum.absolute:
            raise InputError(
                f"{key}: needs a photon number: set source.photons_per_mm2_mas or a tube"
            )
        return spectrum

    def doses(
        self, views: Views, part: str, *, photons: int, simulated: int, voxel_mm: float, key: str
    ) -> Floats:
        """See ``PatientModel``. The table is kept on disk for later plans."""
        specimen, spectrum = self.builder.specimen, self._absolute(key)
        materials = [
            (m.density_g_cm3, sorted(m.mass_fractions.items())) for m in specimen.materials
        ]
        inputs = [specimen.digest, materials, part, voxel_mm, __version__]
        free, source = build_beam(self.builder.scenario.source), self.builder.scenario.source
        inputs += [spectrum.energies_kev.tolist(), spectrum.photons.tolist()]
        inputs += [free.heel, source.bowtie]
        digest = repr(inputs)
        places = once(
            "dose",
            f"{digest} {specimen.world_from_specimen}",
            lambda: PlaceDoses(specimen, free, [part], voxel_mm, f"{key}.voxel_mm"),
        )
        all_over = self._all_over(views, simulated)
        nodes = ViewNodes(all_over, simulated)
        of_nodes = all_over[nodes.chosen.tolist()]
        seen = places.seen(of_nodes)
        vectors = [array.tobytes() for array in (seen.source, seen.detector, seen.u, seen.v)]
        numbers = repr([photons, seen.panel])
        table = made_once(
            "dose",
            [digest.encode(), numbers.encode(), *vectors],
            lambda: {"scattered": places.scattered(of_nodes, photons, progress=views.progress)[0]},
        )["scattered"]
        # Weights beyond the nodes may be negative; a dose is not.
        scattered = np.maximum(nodes.weights(views.geometry) @ table, 0.0)
        doses = places.unscattered(views.geometry) + scattered
        return doses[:, 0] * self.builder.scenario.source.mas

    def _all_over(self, views: Views, number: int) -> ScanGeometry:
        """Return views about the orbit's isocentre, or the evenly spread ones without an orbit."""
        orbit = self.builder.scenario.trajectory
        if isinstance(orbit, OrbitSettings):
            return candidates_of(orbit, number, views.geometry.panel)
        return views.geometry[list(views.even)]

    def signals(self) -> tuple[Floats, Floats]:
        """See ``PatientModel``."""
        spectrum = build_spectrum(self.builder.scenario.source)
        response = build_response(self.builder.scenario.detector)
        return spectrum.energies_kev, spectrum.photons * response.mean(spectrum.energies_kev)

    def body(self, part: str) -> tuple[Body, Pose]:
        """See ``PatientModel``."""
        body_part = self._part(part)
        if not body_part.homogeneous:
            raise InputError(
                f"task: {quoted(part)} is made of voxels; a shadow needs a part of one material"
            )
        return Body(
            body_part.mesh.vertices, body_part.mesh.faces
        ), self.builder.specimen.world_from_specimen

    def material_of(self, part: str) -> Material:
        """See ``PatientModel``."""
        body_part = self._part(part)
        return body_part.mixture(body_part.label_of(part))

    def material(self, name: str, key: str) -> Material:
        """See ``PatientModel``."""
        return material(name, key)

    def seconds_between(self, geometry: ScanGeometry) -> Floats:
        """See ``PatientModel``."""
        if not isinstance(self.builder.scenario.cell, Cell):
            raise InputError("task.moving: a gantry has no moving time; it needs cell.kind: arms")
        return seconds_between(self.builder, geometry)

    def short_tour(self, seconds: Floats) -> list[int]:
        """See ``PatientModel``."""
        return shortest_tour(seconds)
