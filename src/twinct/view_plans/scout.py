"""Registration of a plan's prior to the patient, by a few scout views."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twinct.core.errors import InputError
from twinct.core.progress import Progress
from twinct.geometry import Pose, VolumeGrid
from twinct.recon import Projector, registered
from twinct.runs.reconstruction import load_scan
from twinct.scan import SimulationBuilder
from twinct.scan.integrals import line_integrals
from twinct.view_plans.patient import Patient
from twinct.xray.build import effective_energy_kev

VOXEL_MM = 2.0
"""Voxel size of the registered prior; a plan's prior is coarser."""

AROUND_MM = 20.0
"""Margin around the prior for the patient's displacement."""

FEWEST = 2
"""Smallest number of views: a single one hardly shows displacements along its beam."""


@dataclass(frozen=True, eq=False)
class Scouted:
    """Pose of the patient, estimated from scout views.

    Attributes:
        world_from_specimen: pose of the specimen.
        moved_mm: displacement of its centre from the prior.
        turned_deg: rotation from the prior.
        views: number of scout views.
    """

    world_from_specimen: Pose
    moved_mm: float
    turned_deg: float
    views: int

    @property
    def overrides(self) -> list[str]:
        """Changes ``KEY=VALUE`` that move a scenario's specimen to this pose."""
        position, degrees = self.world_from_specimen.to_euler()
        return [
            f"specimen.position_mm={position.tolist()}",
            f"specimen.rotation_deg={degrees.tolist()}",
        ]


def scouted(builder: SimulationBuilder, path: Path, progress: Progress) -> Scouted:
    """Register the specimen of a scenario, as one volume, to a scan of a few views.

    The poses are the scan's first geometry for reconstruction, normally the believed one.

    Args:
        builder: its specimen is the prior; it may be off by some centimetres and degrees.
        path: folder of a run, or its scan.zarr.
        progress: receives the progress.

    Raises:
        InputError: no scan, too few views, or a scan of something else.
        ScanExistsError: some views are not acquired yet.
    """
    scan = load_scan(path)
    if len(scan) < FEWEST:
        raise InputError(f"{path}: {len(scan)} scout view, but at least {FEWEST} are needed")
    settings = scan.scenario
    energy = effective_energy_kev(settings.source, settings.detector)
    prior = Patient(builder, VOXEL_MM).attenuation(energy)
    more = 2 * int(np.ceil(AROUND_MM / VOXEL_MM))
    wider = VolumeGrid([n + more for n in prior.grid.shape], VOXEL_MM, prior.grid.world_from_grid)
    poses = scan.poses(settings.reconstruction.geometries[0]).geometry(settings.detector.panel)
    good = None if scan.bad_pixels is None else ~scan.bad_pixels
    with progress.stage("registering the prior", 1) as step:
        try:
            pose = registered(
                Projector(poses, wider), line_integrals(scan.transmission), prior, mask=good
            )
        except InputError as error:
            raise InputError(
                f"{path}: the scan does not show the scenario's specimen: {error}"
            ) from None
        step()
    middle = prior.grid.world_from_grid.position
    return Scouted(
        pose @ builder.specimen.world_from_specimen,
        float(np.linalg.norm(pose.apply(middle) - middle)),
        pose.angle_deg(Pose.identity()),
        len(scan),
    )
