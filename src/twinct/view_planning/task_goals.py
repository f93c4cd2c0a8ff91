"""Goals of a scenario's task for candidate views, computed from a model of the patient.

The specimen of the scenario represents the patient, as a prior volume would.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.core.progress import Progress
from twinct.evaluation.signals import contrast_at
from twinct.geometry import Floats, Pose, ScanGeometry, VolumeGrid, fibonacci_directions
from twinct.recon import Projector
from twinct.recon.shadow import Body
from twinct.recon.volume import Volume
from twinct.scan import SimulationBuilder
from twinct.scenario import (
    Cell,
    CompletenessGoal,
    DetectabilityGoal,
    DoseGoal,
    KnownGoal,
    MetalGoal,
    MovingGoal,
    ViewTask,
)
from twinct.specimen import BuiltPart, Material, material
from twinct.specimen.voxels import volume_fractions
from twinct.view_planning import (
    Coverage,
    Goal,
    KnownShare,
    Mean,
    Measure,
    PathTime,
    Task,
    TourTime,
    crossed_planes,
    detectability_of,
    primary_kerma,
    prior_covariance,
    spectral_shift,
    starved_share,
)
from twinct.view_planning.candidates import seconds_between
from twinct.view_planning.detectability import difference_spectrum
from twinct.view_planning.metal_paths import mean_of_views, metal_lengths, seen_lengths
from twinct.view_planning.visibility import sees
from twinct.xray.build import build_response, build_spectrum, effective_energy_kev
from twinct.xray.spectrum import attenuation

PRIOR_MM = 3.0
"""Voxel size of the patient's attenuation volume."""

BOX = 32
"""Voxels along an edge of the grid around the signal."""

POINTS = 12
"""Number of points on the region's surface, in addition to its centre."""

NORMALS = 200
"""Number of planes through each point."""

PIXEL_MM = 1.0
"""Pixel pitch for metal, at the panel; finer pixels are binned."""

ENERGIES = 5
"""Number of energy bins of a spectrum for dose."""

KNOWN_GB = 2.0
"""Memory limit for the rays of the goal ``known``, GB."""

PART_POINTS = 200
"""Largest number of points of a part, such as for its mean kerma."""


@dataclass(frozen=True, eq=False)
class Patient:
    """Model of the specimen for the planning of views.

    Attributes:
        builder: builder of the scenario.
        voxel_mm: voxel size of the specimen's volume.
    """

    builder: SimulationBuilder
    voxel_mm: float = PRIOR_MM

    @cached_property
    def _fractions(self) -> tuple[VolumeGrid, list[tuple[BuiltPart, NDArray[np.float32]]]]:
        """Volume fractions of each part, on a coarse grid that holds all parts."""
        specimen = self.builder.specimen
        low, high = specimen.bounds
        pose = specimen.world_from_specimen @ Pose.from_euler((low + high) / 2, (0.0, 0.0, 0.0))
        count = np.maximum(np.ceil((high - low) / self.voxel_mm).astype(int) + 2, 2)[::-1]
        grid = VolumeGrid(count.tolist(), self.voxel_mm, pose)
        place = specimen.world_from_specimen
        return grid, [
            (part, volume_fractions(part.mesh.vertices, part.mesh.faces, grid, place))
            for part in specimen.parts
        ]

    def attenuation(self, energy_kev: float) -> Volume:
        """Return the attenuation on a coarse grid, 1/mm."""
        grid, fractions = self._fractions
        total = np.zeros(grid.shape, np.float32)
        for part, share in fractions:
            total += np.float32(part.material.mu_per_mm(energy_kev)) * share
        return Volume(total, grid)

    def part(self, name: str) -> BuiltPart:
        """Return a part by its name."""
        return next(part for part in self.builder.specimen.parts if part.name == name)

    def points_of(self, name: str, seed: int) -> Floats:
        """Return points inside a part, in the world, (points, 3), mm."""
        mesh, rng = self.part(name).mesh, np.random.default_rng([seed, 15])
        low, high = np.asarray(mesh.bounds)
        step = float(np.cbrt(mesh.volume / PART_POINTS))
        count = np.maximum(np.ceil((high - low) / step).astype(int), 2)[::-1]
        middle = Pose.from_euler((low + high) / 2, (0.0, 0.0, 0.0))
        grid = VolumeGrid(count.tolist(), (high - low) / count[::-1], middle)
        inside = volume_fractions(mesh.vertices, mesh.faces, grid, Pose.identity()) > 0.5
        index = np.argwhere(inside)[:, ::-1]
        if not len(index):  # a thin plate fills no cell by half
            index = np.array([[n // 2 for n in grid.shape_xyz]])
        if len(index) > PART_POINTS:
            index = rng.permutation(index)[:PART_POINTS]
        local = grid.world_from_grid.apply(index * grid.voxel + grid.first_voxel_mm)
        return self.builder.specimen.world_from_specimen.apply(local)

    def photons(
        self, geometry: ScanGeometry, place: Floats, voxel_mm: float, key: str
    ) -> tuple[ScanGeometry, Floats]:
        """Compute the photons behind the patient, on pixels as coarse as voxels.

        Args:
            geometry: the views.
            place: position of the voxels, in the world, mm.
            voxel_mm: edge of the voxels.
            key: key of the scenario, for messages.

        Returns:
            The views with a coarse panel; photons, (views, rows, columns).

        Raises:
            InputError: the source has no photon number.
        """
        source = self.builder.scenario.source
        spectrum = build_spectrum(source)
        if not spectrum.absolute:
            raise InputError(
                f"{key}: needs a photon number: set source.photons_per_mm2_mas or a tube"
            )
        panel = geometry.panel
        shrink = np.linalg.norm(geometry.source - place, axis=1) / geometry.sdd_to_centre
        pixel = voxel_mm / float(shrink.mean())
        rows, columns = (max(1, int(pixel / pitch)) for pitch in (panel.pitch_v, panel.pitch_u))
        coarse = geometry.binned(min(rows, panel.rows), min(columns, panel.columns))
        energy = effective_energy_kev(source, self.builder.scenario.detector)
        prior = self.attenuation(energy)
        depth = Projector(coarse, prior.grid)(prior.array)
        area = coarse.panel.pitch_u * coarse.panel.pitch_v
        free = spectrum.total * source.mas * area * (1000 / coarse.sdd_to_centre) ** 2
        return coarse, free[:, None, None] * np.exp(-depth)


def region_points(task: ViewTask, world_from_specimen: Pose) -> Floats:
    """Return the centre of the task's region and points on its surface, world, (points, 3), mm."""
    around = task.radius_mm * fibonacci_directions(POINTS)
    points = np.vstack([np.zeros((1, 3)), around[: POINTS if task.radius_mm else 0]])
    return world_from_specimen.apply(points + np.asarray(task.position_mm))


def goals_of(
    builder: SimulationBuilder,
    geometry: ScanGeometry,
    candidates: int,
    even: Sequence[int],
    progress: Progress,
) -> list[Goal]:
    """Build the goals of the task, for views given by their index in a geometry.

    Args:
        builder: builder of a scenario with a task.
        geometry: candidates, followed by other views for comparison.
        candidates: number of candidates.
        even: evenly spread candidates; their measures are the units.
        progress: receives the progress.

    Raises:
        InputError: no view sees the region, or a goal needs a photon number that is not given.
    """
    task, patient = builder.scenario.task, Patient(builder)
    assert task is not None
    points = region_points(task, builder.specimen.world_from_specimen)
    if not sees(geometry[:candidates], points[:1]).any():
        raise InputError(_unseen(builder, task))
    goals: list[Goal] = []
    if task.completeness is not None:
        angle = task.completeness.within_deg
        covers = crossed_planes(geometry, points, angle, NORMALS)
        goals.append(_goal("completeness", Coverage(covers), task.completeness, even))
    if (section := task.detectability) is not None:
        measure = _detectability(patient, section, geometry, points[0], even, progress)
        goals.append(_goal("detectability", measure, section, even))
    if (section := task.known) is not None:
        measure = _known(patient, task, section, geometry, points[0])
        goals.append(_goal("known", measure, section, even))
    if (section := task.metal) is not None:
        goals.append(_cost("metal", section, _metal(patient, section, geometry, points), even))
    if (section := task.dose) is not None:
        goals.append(_cost("dose", section, _dose(patient, section, geometry), even))
    if (section := task.moving) is not None:
        goals.append(_moving(builder, section, geometry, even, in_order=task.family is not None))
    return goals


def _moving(
    builder: SimulationBuilder,
    section: MovingGoal,
    geometry: ScanGeometry,
    even: Sequence[int],
    *,
    in_order: bool,
) -> Goal:
    """Build the goal of the arms' moving time, in the order of views or on the shortest tour."""
    if not isinstance(builder.scenario.cell, Cell):
        raise InputError("task.moving: a gantry has no moving time; it needs cell.kind: arms")
    from twinct.robots.motion import shortest_tour

    seconds = seconds_between(builder, geometry)
    tour = TourTime(seconds, shortest_tour)
    spread = Goal("moving", tour, 0.0).of(even)
    limit = None if section.at_most_rel is None else section.at_most_rel * spread
    measure = PathTime(seconds) if in_order else tour
    return Goal("moving", measure, -section.weight, spread or 1.0, limit)


def _goal(
    name: str,
    measure: Measure,
    section: CompletenessGoal | DetectabilityGoal | KnownGoal,
    even: Sequence[int],
) -> Goal:
    unit = Goal(name, measure, 0.0).of(even)
    if not unit > 0:
        raise InputError(
            f"task.{name} is 0 for views spread evenly over all reachable ones, as only few see "
            "the region (task.position_mm); every view sees the isocentre of the trajectory"
        )
    least = None if section.at_least_rel is None else section.at_least_rel * unit
    return Goal(name, measure, section.weight, unit, at_least=least)


def _cost(name: str, section: MetalGoal | DoseGoal, each: Floats, even: Sequence[int]) -> Goal:
    measure = Mean(each)
    spread = float(each[list(even)].mean())
    limit = None if section.at_most_rel is None else section.at_most_rel * spread
    # If evenly spread views have zero cost, no other choice has much.
    return Goal(name, measure, -section.weight, spread or 1.0, limit)


@dataclass(frozen=True, eq=False)
class _Metal:
    """Metal in the beam.

    Attributes:
        substances: material of each body.
        points: returns points of the metal, (points, 3), mm.
        lengths: returns path lengths in each body of rays through points, (bodies, points seen)
            for each view.
    """

    substances: list[Material]
    points: Callable[[], Floats]
    lengths: Callable[[ScanGeometry, Floats], list[Floats]]


def _metal_of(patient: Patient, section: MetalGoal) -> _Metal:
    """Return the metal of the specimen's parts, or the metal in a volume.

    Raises:
        InputError: an unreadable volume or one without metal, or an unknown material.
    """
    if (seen := section.seen) is None:
        place, seed = patient.builder.specimen.world_from_specimen, patient.builder.scenario.seed
        parts = [patient.part(name) for name in section.parts]
        bodies = [(Body(one.mesh.vertices, one.mesh.faces), place) for one in parts]
        return _Metal(
            [one.material for one in parts],
            lambda: np.vstack([patient.points_of(name, seed) for name in section.parts]),
            lambda geometry, points: metal_lengths(geometry, bodies, points),
        )
    volume = Volume.read(seen.path)
    there = volume.array > seen.above_per_mm
    if not there.any():
        raise InputError(
            f"task.metal.seen.above_per_mm: no voxel of {seen.path} is above {seen.above_per_mm:g} "
            f"1/mm: the largest is {float(volume.array.max()):.3g}"
        )
    grid, index = volume.grid, np.argwhere(there)[:, ::-1]
    some = np.random.default_rng(patient.builder.scenario.seed).permutation(len(index))
    local = index[some[:PART_POINTS]] * grid.voxel + grid.first_voxel_mm
    return _Metal(
        [material(seen.material, "task.metal.seen.material")],
        lambda: grid.world_from_grid.apply(local),
        lambda geometry, points: seen_lengths(Projector(geometry, grid), there, points),
    )


def _metal(patient: Patient, section: MetalGoal, geometry: ScanGeometry, points: Floats) -> Floats:
    """Return the effect of metal on each view; the maximum for views that see no point."""
    scenario, panel = patient.builder.scenario, geometry.panel
    metal = _metal_of(patient, section)
    if section.rays == "metal":
        points = metal.points()
    factors = (max(1, int(PIXEL_MM / pitch)) for pitch in (panel.pitch_v, panel.pitch_u))
    lengths = metal.lengths(geometry.binned(*factors), points)
    if section.counts == "length":
        found = mean_of_views([one.sum(axis=0) for one in lengths])
    elif section.counts == "shift":
        spectrum = build_spectrum(scenario.source)
        if len(spectrum.photons) < 2:
            raise InputError(
                "task.metal.counts: shift: a single energy does not harden; use a tube"
            )
        weights = spectrum.photons * build_response(scenario.detector).mean(spectrum.energies_kev)
        mu = [attenuation(one, spectrum.energies_kev) for one in metal.substances]
        found = mean_of_views([spectral_shift(one, mu, weights) for one in lengths])
    else:
        coarse, photons = patient.photons(geometry, points[0], PRIOR_MM, "task.metal.counts")
        if section.seen is not None:  # the prior may lack this metal
            energy = effective_energy_kev(scenario.source, scenario.detector)
            volume = Volume.read(section.seen.path)
            there = (volume.array > section.seen.above_per_mm).astype(np.float32)
            mu_per_mm = metal.substances[0].mu_per_mm(energy)
            photons = photons * np.exp(-mu_per_mm * Projector(coarse, volume.grid)(there))
        pixels = coarse.panel.pitch_u * coarse.panel.pitch_v / (panel.pitch_u * panel.pitch_v)
        found = starved_share(coarse, photons, points, section.least_photons * pixels)
    return np.nan_to_num(found, nan=float(np.nanmax(found)))


def _dose(patient: Patient, section: DoseGoal, geometry: ScanGeometry) -> Floats:
    """Return the primary kerma of each view, Gy."""
    scenario = patient.builder.scenario
    spectrum = build_spectrum(scenario.source)
    if not spectrum.absolute:
        raise InputError(
            "task.dose: needs a photon number: set source.photons_per_mm2_mas or a tube"
        )
    spectrum = spectrum.rebinned(min(ENERGIES, len(spectrum.photons)))
    points = patient.points_of(section.part, scenario.seed)
    substance, kerma = patient.part(section.part).material, np.zeros(len(geometry))
    for energy, photons in zip(
        spectrum.energies_kev.tolist(), spectrum.photons.tolist(), strict=True
    ):
        kerma += primary_kerma(
            geometry,
            points,
            patient.attenuation(energy),
            energy_kev=energy,
            photons_per_mm2=photons * scenario.source.mas,
            absorption_cm2_g=substance.absorption_cm2_g(energy),
        )
    return kerma


def _detectability(
    patient: Patient,
    section: DetectabilityGoal,
    geometry: ScanGeometry,
    place: Floats,
    even: Sequence[int],
    progress: Progress,
) -> Measure:
    """Build the measure d' of the signal in the centre of the region."""
    scenario, voxel = patient.builder.scenario, section.voxel_mm
    energy = effective_energy_kev(scenario.source, scenario.detector)
    z, y, x = np.indices((BOX, BOX, BOX)) - BOX // 2
    radius = voxel * np.sqrt(x * x + y * y + z * z)
    contrast = contrast_at(section.signal, radius, voxel)
    signal = contrast * patient.builder.specimen.reference_mu(energy)
    # Centre voxel BOX // 2 at the place.
    grid = VolumeGrid((BOX,) * 3, voxel, Pose.from_euler(place - voxel / 2, (0.0, 0.0, 0.0)))
    coarse, photons = patient.photons(geometry, place, voxel, "task.detectability")
    projector = Projector(coarse, grid)
    found = detectability_of(projector, photons, Task(signal, 1.0), progress)
    power = np.abs(np.fft.rfftn(signal)) ** 2
    told = found.fisher[list(even)].sum(axis=0, dtype=np.float64)
    beta = section.penalty * float(
        (power * told).sum() / (power * difference_spectrum(signal.shape)).sum()
    )
    if not beta > 0:
        raise InputError(
            "task.detectability: views spread evenly over all reachable ones carry no information "
            "on the signal, as only few see it (task.position_mm)"
        )
    return type(found)(Task(signal, beta), found.fisher)


def _known(
    patient: Patient, task: ViewTask, section: KnownGoal, geometry: ScanGeometry, place: Floats
) -> Measure:
    """Build the measure of the share of the region's variance that views remove."""
    scenario = patient.builder.scenario
    energy = effective_energy_kev(scenario.source, scenario.detector)
    mu = patient.builder.specimen.reference_mu(energy)
    around = patient.attenuation(energy).grid
    edges = around.size_mm
    voxel = float(np.cbrt(edges.prod() / section.voxels))
    count = np.maximum(np.floor(edges / voxel).astype(int), 1)  # at most the requested number
    grid = VolumeGrid(count[::-1].tolist(), edges / count, around.world_from_grid)
    coarse, photons = patient.photons(geometry, place, voxel, "task.known")
    held = photons.size * int(count.prod()) * 4 / 1e9
    if held > KNOWN_GB:
        raise InputError(
            f"task.known.voxels: {section.voxels} need {held:.1f} GB for {len(geometry)} views, "
            f"at most {KNOWN_GB:g} GB are allowed; use fewer voxels or fewer task.candidates"
        )
    z, y, x = np.meshgrid(*grid.axes()[::-1], indexing="ij")
    far = np.linalg.norm(grid.world_from_grid.apply(np.stack([x, y, z], -1)) - place, axis=-1)
    region = far <= max(task.radius_mm, float(far.min()))
    covariance = prior_covariance(grid, section.deviation_rel * mu, section.correlation_mm)
    return KnownShare.of(Projector(coarse, grid), photons, covariance, region)


def _unseen(builder: SimulationBuilder, task: ViewTask) -> str:
    x, y, z = builder.specimen.world_from_specimen.apply(np.asarray(task.position_mm)).tolist()
    return (
        f"task.position_mm: no reachable view sees the region at ({x:.0f}, {y:.0f}, {z:.0f}) mm in "
        "the world; every view sees the isocentre of the trajectory"
    )
