"""Where the patient lies: a few scout views move a plan's prior to where they saw it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twinct.errors import InputError
from twinct.geometry import Pose, VolumeGrid
from twinct.progress import Progress
from twinct.recon import Projector, registered
from twinct.runs.again import load_scan
from twinct.runs.view_goals import Patient
from twinct.runs.volumes import line_integrals
from twinct.scan import Workshop
from twinct.scenario import Scenario
from twinct.xray.build import effective_energy_kev

VOXEL_MM = 2.0
"""Voxels of the prior that is registered: those a plan takes are coarser."""

AROUND_MM = 20.0
"""How far the patient may lie beside the prior."""

FEWEST = 2
"""Views: along the beam of a single one hardly anything is seen."""


@dataclass(frozen=True, eq=False)
class Scouted:
    """Where scout views saw the patient.

    Attributes:
        world_from_specimen: where the specimen lies.
        moved_mm: how far its middle is from where the prior had it.
        turned_deg: and how far it is turned.
        views: how many scout views told it.
    """

    world_from_specimen: Pose
    moved_mm: float
    turned_deg: float
    views: int

    @property
    def overrides(self) -> list[str]:
        """``KEY=VALUE`` that move the specimen of a scenario."""
        position, degrees = self.world_from_specimen.to_euler()
        return [
            f"specimen.position_mm={position.tolist()}",
            f"specimen.rotation_deg={degrees.tolist()}",
        ]


def scouted(scenario: Scenario, path: Path, progress: Progress) -> Scouted:
    """Register the specimen of a scenario, as one volume, to a scan of a few views.

    Poses are those that the scan's first volume is made of, which are believed, not executed.

    Args:
        scenario: whose specimen is the prior; it may lie some centimetres and degrees off.
        path: folder of a run, or its scan.zarr.
        progress: hears how far it is.

    Raises:
        InputError: no scan, too few views, or one of something else.
        ScanExistsError: not all of its views were acquired yet.
    """
    scan = load_scan(path)
    if len(scan) < FEWEST:
        raise InputError(f"{path}: {len(scan)} scout view: at least {FEWEST} are needed")
    settings = scan.scenario
    workshop = Workshop(scenario)
    specimen = workshop.specimen
    energy = effective_energy_kev(settings.source, settings.detector)
    prior = Patient(workshop, VOXEL_MM).attenuation(energy)
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
                f"{path}: the scenario's specimen is not what it shows: {error}"
            ) from None
        step()
    middle = prior.grid.world_from_grid.position
    return Scouted(
        pose @ specimen.world_from_specimen,
        float(np.linalg.norm(pose.apply(middle) - middle)),
        pose.angle_deg(Pose.identity()),
        len(scan),
    )
