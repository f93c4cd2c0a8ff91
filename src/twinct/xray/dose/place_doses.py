"""Dose of views to a specimen: its voxels, and the means of its parts and labels.

Unscattered photons give their dose along rays, without chance; all others by Monte Carlo. Dose is
the collision kerma, which equals it where electrons deposit their energy locally. The mean dose of
a part or label is its energy by its mass. A voxel that it fills in part counts with the mass that
it has there; a label counts the voxels that it fills by half at least.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.foreign_text import quoted
from twinct.core.progress import SILENT, Progress
from twinct.geometry import Floats, Pose, ScanGeometry, VolumeGrid
from twinct.specimen import BuiltSpecimen, Part
from twinct.transport import Regions, Scores, Simulation
from twinct.transport.cross_sections import require_energies
from twinct.xray.beam_shape import BeamShape
from twinct.xray.voxel_specimen import grid_of, in_voxels

GY_PER_KEV_G = 1.602176634e-13
"""1 keV/g in Gy: J per keV times g per kg."""

MM2_PER_SR_AT_1_M = 1e6

BATCHES = 8
"""Batches of each view: errors of a path come from all of its views together."""

MOST_RAYS = 10_000
"""Voxels of a place to which rays go, if only its mean counts, drawn by chance: within 1 %."""


@dataclass(frozen=True, eq=False)
class PathDose:
    """Dose of a path.

    Attributes:
        names: parts and labels.
        masses_g: their masses on the grid, g, (places,).
        unscattered: mean dose of each by unscattered photons, Gy, (places,).
        scattered: by all others, Gy, (places,).
        errors: standard error of the latter, Gy, (places,).
        grid: voxels, in the specimen's frame.
        voxels: dose of each voxel, Gy, (z, y, x); 0 without mass.
        voxel_errors: their standard errors, Gy.
    """

    names: tuple[str, ...]
    masses_g: Floats
    unscattered: Floats
    scattered: Floats
    errors: Floats
    grid: VolumeGrid
    voxels: NDArray[np.float32]
    voxel_errors: NDArray[np.float32]

    @property
    def doses(self) -> Floats:
        """Mean dose of each place, Gy, (places,)."""
        return self.unscattered + self.scattered


class PlaceDoses:
    """Doses of views to places of a specimen, which rests in its reference state, in vacuum."""

    def __init__(
        self,
        specimen: BuiltSpecimen,
        free: BeamShape,
        names: Sequence[str],
        voxel_mm: float,
        key: str,
    ) -> None:
        """Prepare the body.

        Args:
            specimen: the specimen.
            free: the free beam.
            names: parts and labels.
            voxel_mm: edge of the voxels.
            key: place of ``voxel_mm`` in the messages.

        Raises:
            InputError: a name is unknown, a place fills no voxel, there are too many voxels, a
                photon energy is outside the tables, or the number of photons is unknown.
        """
        spectrum = free.spectrum
        if not spectrum.absolute:
            raise InputError("dose needs a photon number: set source.photons_per_mm2_mas or a tube")
        require_energies(spectrum.energies_kev, "source")
        self.names, self._free = tuple(names), free
        self.grid = grid_of(specimen, voxel_mm, key)
        self._body = in_voxels(specimen, self.grid)
        self._voxel_masses = self._body.masses_g().ravel()
        self._world = specimen.world_from_specimen
        places, shares, masses = [], [], []
        for name in self.names:
            part = specimen.named(name, "dose")
            mass = self._mass_on_grid(part, part.label_of(name))
            (there,) = np.nonzero(mass)
            if not len(there):
                raise InputError(
                    f"{key} {voxel_mm:g}: {quoted(name)} fills no voxel by half; choose smaller "
                    "voxels"
                )
            masses.append(float(mass[there].sum()))
            places.append(there)
            shares.append(mass[there] / (self._voxel_masses[there] * masses[-1]))
        self.masses_g = np.array(masses)
        self._regions = Regions.of_places(self.names, self.grid.shape, places, shares)

    def _mass_on_grid(self, part: Part, label: str) -> Floats:
        """Return the mass of a part or label in each voxel, g, (voxels,)."""
        at_rest = Pose.identity()
        if label:
            there = part.label_on(label, self.grid, at_rest).ravel()
            return np.where(there, self._voxel_masses, 0.0)
        mass = np.zeros(self.grid.shape)
        for substance, share in part.shares(self.grid, at_rest):
            mass += substance.density_g_cm3 * share
        volume_cm3 = float(np.prod(self.grid.voxel)) / 1000
        # The body rounds densities; no part is heavier than its voxels.
        return np.minimum(mass.ravel() * volume_cm3, self._voxel_masses)

    def seen(self, views: ScanGeometry) -> ScanGeometry:
        """Return views of the world in the frame of the specimen."""
        return self._world.inverse() @ views

    def unscattered(self, views: ScanGeometry) -> Floats:
        """Return the mean doses by unscattered photons, Gy per mAs, (views, places).

        The views are in the world.
        """
        seen, doses = self.seen(views), np.empty((len(views), len(self.names)))
        cells, weights = self._rays
        for view in range(len(seen)):
            simulation, gy = self._simulation(seen, view)
            doses[view] = gy * (weights @ simulation.primary_energy(cells))
        return doses

    @cached_property
    def _rays(self) -> tuple[NDArray[np.int64], Floats]:
        """Voxels that rays go to, and the weight of their energies in each place's mean dose."""
        shares, rng = self._regions.shares, np.random.default_rng(MOST_RAYS)
        chosen = [
            np.sort(rng.permutation(shares.indices[a:b])[:MOST_RAYS])
            for a, b in zip(shares.indptr, shares.indptr[1:], strict=False)
        ]
        cells = np.unique(np.concatenate(chosen)).astype(np.int64)
        weights = np.zeros((len(self.names), len(cells)))
        for row, some in enumerate(chosen):
            at = np.searchsorted(cells, some)
            weights[row, at] = shares[[row]][:, some].toarray()[0]
            weights[row] /= weights[row] @ self._voxel_masses[cells]
        return cells, weights

    def scattered(
        self, views: ScanGeometry, photons: int, *, seed: int = 0, progress: Progress = SILENT
    ) -> tuple[Floats, Floats]:
        """Return the mean doses by scattered photons, and their standard errors.

        Args:
            views: views in the world.
            photons: photons of each view.
            seed: seed of the random numbers.
            progress: receives the progress, by views.

        Returns:
            Gy per mAs, each (views, places).
        """
        doses, errors = (np.empty((len(views), len(self.names))) for _ in range(2))
        seen = self.seen(views)
        with progress.stage("dose", len(views)) as step:
            for view in range(len(seen)):
                scores, gy, _ = self._scored(seen, view, photons, seed)
                pairs = np.array(list(scores.region_energy().values()))
                doses[view], errors[view] = gy * pairs.T
                step()
        return doses, errors

    def of_path(
        self,
        views: ScanGeometry,
        mas: Floats,
        photons: int,
        *,
        seed: int = 0,
        progress: Progress = SILENT,
    ) -> PathDose:
        """Return the dose of a path, as a map and in each place.

        Args:
            views: views in the world.
            mas: tube load of each view, (views,), mAs.
            photons: photons of each view.
            seed: seed of the random numbers.
            progress: receives the progress, by views.
        """
        total, variance = (np.zeros(self.grid.shape) for _ in range(2))
        by_place = np.zeros((3, len(self.names)))
        shares, seen = self._regions.shares, self.seen(views)
        with progress.stage("dose", len(views)) as step:
            for view, load in enumerate(mas.tolist()):
                scores, per_mas, simulation = self._scored(seen, view, photons, seed)
                gy, primary = load * per_mas, simulation.primary_energy()
                mean, error = scores.voxel_energy()
                total += gy * (primary + mean)
                variance += (gy * error) ** 2
                pairs = np.array(list(scores.region_energy().values()))
                by_place[0] += gy * (shares @ primary.ravel())
                by_place[1] += gy * pairs[:, 0]
                by_place[2] += (gy * pairs[:, 1]) ** 2
                step()
        mass = np.maximum(self._voxel_masses.reshape(total.shape), 1e-300)
        some = self._voxel_masses.reshape(total.shape) > 0
        voxels, errors = (
            np.where(some, array / mass, 0).astype(np.float32) for array in (total, variance**0.5)
        )
        errors_by_place = np.sqrt(by_place[2])
        return PathDose(
            self.names,
            self.masses_g,
            by_place[0],
            by_place[1],
            errors_by_place,
            self.grid,
            voxels,
            errors,
        )

    def _simulation(self, seen: ScanGeometry, view: int) -> tuple[Simulation, float]:
        """Return the simulation of a view, and Gy per mAs for 1 keV/g of each photon."""
        beam = self._free.beam(seen, view)
        in_field = self._free.spectrum.total * MM2_PER_SR_AT_1_M * beam.solid_angle * beam.share
        simulation = Simulation(self._body, beam, regions=self._regions, unscattered=False)
        return simulation, in_field * GY_PER_KEV_G

    def _scored(
        self, seen: ScanGeometry, view: int, photons: int, seed: int
    ) -> tuple[Scores, float, Simulation]:
        simulation, gy = self._simulation(seen, view)
        scores = simulation.run(-(-photons // BATCHES), BATCHES, seed=seed, view=view)
        return scores, gy, simulation
