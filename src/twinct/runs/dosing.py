"""Dose of a scenario's path to its specimen."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from twinct.core.arguments import kinds_checked
from twinct.core.errors import InputError
from twinct.core.extras import require
from twinct.core.files.writing import check_folder, storage_errors, write_json
from twinct.observers import Observers, audience_of
from twinct.recon.volume import Volume
from twinct.runs.remedies import explained
from twinct.scan import SimulationBuilder
from twinct.scenario import Scenario, as_scenario
from twinct.trajectory import OrbitSettings
from twinct.xray.build import build_beam
from twinct.xray.dose import (
    EffectiveDose,
    PathDose,
    PlaceDoses,
    effective_dose,
    kerma_area_product_gy_cm2,
    reference_kerma_gy,
)

PHOTONS = 10_000_000
"""A head takes half a minute of a processor."""

VOXEL_MM = 2.0


@dataclass(frozen=True, eq=False)
class Dose:
    """Dose of a path.

    Attributes:
        path: doses of parts and labels, and of voxels.
        gray: dose of each voxel, Gy, in the world.
        effective: effective dose, or the tissues that have no label.
        reference_kerma_gy: air kerma at the reference point, Gy; None without an isocentre, or if
            a focal spot is less than 15 cm from it.
        kerma_area_product_gy_cm2: product of air kerma and area of the field, Gy cm^2.
    """

    path: PathDose
    gray: Volume
    effective: EffectiveDose
    reference_kerma_gy: float | None
    kerma_area_product_gy_cm2: float

    @property
    def data(self) -> dict[str, Any]:
        """All but the voxels, as plain data."""
        path, effective = self.path, self.effective
        columns = path.names, path.doses, path.errors, path.unscattered, path.masses_g
        return {
            "places": {
                name: {"dose_gy": dose, "error_gy": error, "unscattered_gy": free, "mass_g": mass}
                for name, dose, error, free, mass in zip(*map(list, columns), strict=True)
            },
            "effective_sv": effective.sievert,
            "effective_error_sv": effective.error,
            "tissues_without_label": list(effective.missing),
            "reference_kerma_gy": self.reference_kerma_gy,
            "kerma_area_product_gy_cm2": self.kerma_area_product_gy_cm2,
        }


@kinds_checked
def dose(
    scenario: Scenario | str | Path,
    *,
    photons: int = PHOTONS,
    voxel_mm: float = VOXEL_MM,
    seed: int = 0,
    out: str | Path | None = None,
    observers: Observers = (),
) -> Dose:
    """Compute the dose of a scenario's commanded views to its specimen, with scattered photons.

    The specimen rests in its reference state, in vacuum; the beam covers just the panel.

    Args:
        scenario: the scenario, or its file.
        photons: photons that are followed, in all views together.
        voxel_mm: edge of the voxels that stand for the specimen.
        seed: seed of the random numbers.
        out: folder for dose.json, and dose.nii with the dose of each voxel in Gy.
        observers: notified of the progress.

    Raises:
        InputError: the source has no photon number, an energy is above 150 keV, a label fills no
            voxel, or a number is out of range.
        TrajectoryError: a view is out of reach or would collide.
        StorageError: the folder cannot be written.
    """
    scenario = as_scenario(scenario)
    if photons < 1 or not 0 < voxel_mm < np.inf:
        raise InputError(
            f"photons {photons}, voxel_mm {voxel_mm:g}: must be at least 1, and above 0"
        )
    if scenario.cell.kind == "arms":
        require("robots")
    if out is not None:
        check_folder(out := Path(out))
    builder, free = SimulationBuilder(scenario), build_beam(scenario.source)
    specimen = builder.specimen
    names = [name for part in specimen.parts for name in (part.name, *part.label_names)]
    with audience_of(observers) as audience, explained(builder, None, progress=audience):
        views, mas = builder.commanded, builder.mas
        mas = np.full(len(views), scenario.source.mas) if mas is None else mas
        places = PlaceDoses(specimen, free, names, voxel_mm, "voxel_mm")
        each = -(-photons // len(views))
        path = places.of_path(views, mas, each, seed=seed, progress=audience)
    trajectory, reference = scenario.trajectory, None
    if isinstance(trajectory, OrbitSettings):
        total = float(reference_kerma_gy(free, views, trajectory.isocentre_mm) @ mas)
        reference = None if np.isnan(total) else total
    grid = path.grid
    in_world = replace(grid, world_from_grid=specimen.world_from_specimen @ grid.world_from_grid)
    columns = zip(path.doses.tolist(), path.errors.tolist(), path.masses_g.tolist(), strict=True)
    made = Dose(
        path,
        Volume(path.voxels, in_world),
        effective_dose(dict(zip(path.names, columns, strict=True))),
        reference,
        float(kerma_area_product_gy_cm2(free, views) @ mas),
    )
    if out is not None:
        with storage_errors(out):
            out.mkdir(parents=True, exist_ok=True)
            made.gray.write(out / "dose.nii")
            write_json(out / "dose.json", made.data)
    return made
