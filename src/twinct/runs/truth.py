"""Truth of a scan: computed once for a specimen, a grid and its views, and kept by its digest."""

from __future__ import annotations

import hashlib
import json
import logging
import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twinct.core.cached import forget, once
from twinct.core.errors import InputError
from twinct.evaluation import (
    Edges,
    ImageReference,
    RegionDepth,
    edges_of,
    region_depth,
    region_of_interest,
)
from twinct.evaluation.image import REFERENCE_SHARE
from twinct.geometry import Pose, ScanGeometry, VolumeGrid
from twinct.geometry.arrays import lock
from twinct.observers import Audience
from twinct.recon.volume import Volume
from twinct.runs.known_motion import as_reconstructed
from twinct.scan import Scan, SimulationBuilder
from twinct.specimen import BuiltSpecimen, material
from twinct.xray.build import effective_energy_kev

log = logging.getLogger(__name__)

VERSION = 1
"""Version of the computation of a true volume; raise it when the values change."""

_MOST_KEPT = 2**29
"""Bytes of the largest truth that a process keeps after its use; 512^3 voxels have 0.7 GB."""


@dataclass(frozen=True, eq=False)
class Truth:
    """Truth against which a reconstruction is judged.

    Attributes:
        volume: attenuation of the specimen, (z, y, x), 1/mm, float32.
        region: voxels that every view sees, (z, y, x), bool.
        mu_reference: attenuation to which figures are relative, 1/mm.
        grid: grid of volume and region.
        executed: executed geometry of the views, relative to the specimen.
        note: note in the volume's file, which identifies it.
        mu_water: attenuation of water at the energy of the volume, 1/mm.
        body: voxels that count as reference material, (z, y, x), bool, if that is a mixture.
    """

    volume: NDArray[np.float32]
    region: NDArray[np.bool_]
    mu_reference: float
    grid: VolumeGrid
    executed: ScanGeometry
    note: str = "twinct truth, 1/mm"
    mu_water: float = math.nan
    body: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        """Lock the arrays, which a process keeps for others."""
        lock(self, "volume", "region", *(["body"] if self.body is not None else []))

    @cached_property
    def depth(self) -> RegionDepth:
        """Depth of the voxels in the region."""
        return region_depth(self.executed, self.grid)

    @cached_property
    def edges(self) -> Edges:
        """Profiles across the true surface."""
        return edges_of(self.volume, self.region, self.mu_reference, self.grid)

    @cached_property
    def reference(self) -> ImageReference:
        """Truth with the masks of the image figures."""
        return ImageReference(
            self.volume, self.region, self.mu_reference, self.grid, body=self.body
        )

    def written(self, path: Path) -> Truth:
        """Write the volume as NIfTI, unless the file holds it already.

        Returns:
            The truth; a large volume is mapped from the file, and takes no memory until its use.
        """
        if _stored(path, self.note, self.grid) is None:
            Volume(self.volume, self.grid).write(path, self.note)
        if not _is_large(self.grid):
            return self
        return replace(self, volume=Volume.read(path).array)


def truth_of(
    scan: Scan,
    builder: SimulationBuilder,
    audience: Audience | None = None,
    grid: VolumeGrid | None = None,
    file: Path | None = None,
) -> Truth:
    """Return the true volume of a scan, with the specimen's true pose, and its region.

    A process keeps the last truth, so that further volumes of a scan share it with its masks.

    Args:
        scan: executed poses and scenario.
        builder: the specimen.
        audience: notified of the stage.
        grid: grid of the truth; the scenario's if None.
        file: file of ``Truth.written``, which is read if it holds this truth.
    """
    scenario = scan.scenario
    specimen = as_reconstructed(builder.specimen, scenario)
    grid = grid or scenario.reconstruction.volume_grid
    energy = effective_energy_kev(scenario.source, scenario.detector)
    executed = scan.relative.geometry(scenario.detector.panel)
    note = f"twinct truth {_digest(specimen, energy, scan.stands, grid)[:32]}, 1/mm"

    def make() -> Truth:
        with (audience or Audience()).stage("truth", 2) as step:
            stored = _stored(file, note, grid) if file else None
            # A copy: the file may change later, and with it an array that is mapped from it.
            volume = stored.array.copy() if stored else specimen.truth(grid, energy, scan.stands)
            del stored
            step()
            region = region_of_interest(executed, grid)
            step()
        mu = specimen.reference_mu(energy)
        if file:  # little else reads the voxels
            for part in (*specimen.parts, *builder.specimen.parts):
                part.spill(file.parent)
        body = reference_voxels(specimen, volume, mu, grid, scan.stands)
        water = material("water").mu_per_mm(energy)
        return Truth(volume, region, mu, grid, executed, note, water, body)

    if _is_large(grid):
        forget("truth")
        return make()
    views = hashlib.sha256()
    for array in (executed.source, executed.detector, executed.u, executed.v):
        views.update(np.ascontiguousarray(array).data)
    inputs = [note, views.hexdigest(), repr(executed.panel), specimen.reference_mu(energy)]
    inputs += [specimen.reference] if specimen.mixtures else []
    return once("truth", json.dumps(inputs), make)


def held_bytes(grid: VolumeGrid) -> int:
    """Return the bytes of a written truth and its region during other work."""
    return (1 if _is_large(grid) else 5) * math.prod(grid.shape)


def _is_large(grid: VolumeGrid) -> bool:
    return 5 * math.prod(grid.shape) > _MOST_KEPT


def reference_voxels(
    specimen: BuiltSpecimen,
    volume: NDArray[np.float32],
    mu_reference: float,
    grid: VolumeGrid,
    world_from_specimen: Pose,
) -> NDArray[np.bool_] | None:
    """Return the voxels of the reference in a mixture: those of its label, or dense ones.

    None if the reference is a part of one material.

    Args:
        specimen: specimen with its reference.
        volume: its true attenuation on the grid, (z, y, x), 1/mm.
        mu_reference: attenuation of the reference, 1/mm.
        grid: grid of the volume.
        world_from_specimen: pose of the specimen.
    """
    if specimen.reference_part.homogeneous:
        return None
    label = specimen.reference_voxels(grid, world_from_specimen)
    return volume >= REFERENCE_SHARE * mu_reference if label is None else label


def _digest(
    specimen: BuiltSpecimen, energy_kev: float, world_from_specimen: Pose, grid: VolumeGrid
) -> str:
    """Return the SHA-256 of all inputs of a true volume."""
    mu = [part.material.mu_per_mm(energy_kev) for part in specimen.parts]
    mu += [m.mu_per_mm(energy_kev) for part in specimen.mixtures for m in part.materials]
    poses = [
        [*pose.position.tolist(), *pose.quat.tolist()]
        for pose in (world_from_specimen, grid.world_from_grid)
    ]
    inputs = [VERSION, specimen.digest, mu, poses, grid.shape, grid.voxel.tolist()]
    return hashlib.sha256(json.dumps(inputs).encode()).hexdigest()


def _stored(path: Path, note: str, grid: VolumeGrid) -> Volume | None:
    """Return the volume of a file with this note; None if there is none, or it is damaged."""
    if not path.is_file():
        return None
    try:
        volume = Volume.read(path)
        volume.require_grid(grid)
    except InputError as error:
        log.warning("%s; it is made again", error)
        return None
    return volume if volume.extras["note"] == note else None
