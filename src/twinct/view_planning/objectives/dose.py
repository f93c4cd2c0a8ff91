"""Dose of each view to a part of the patient: primary kerma.

Photons that reach a point without an interaction give it the kerma

    K = phi E mu_en / rho,    phi = n mAs (1 m / r)^2 exp(-int mu dl)

where n is the number of photons per mm^2 and mAs at 1 m, r the distance from the focal spot, and
the integral goes from the focal spot to the point; the energies of a spectrum add up (F. H. Attix,
Introduction to Radiological Physics and Radiation Dosimetry, 1986). Scattered photons are
neglected; they spread more evenly, so that the true doses of views differ less than K.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy
from numpy.typing import ArrayLike
from pydantic import Field

from twinct.geometry import Floats, ScanGeometry
from twinct.recon.volume import Volume
from twinct.view_planning.objectives.measures import Mean
from twinct.view_planning.objectives.objective import (
    LessIsBetter,
    Objective,
    PatientModel,
    Views,
    unknown_parts,
)
from twinct.view_planning.objectives.visibility import samples_towards, sees

GY_MM2 = 1.602176634e-16 * 1e3 * 100.0
"""1 keV cm^2/g per mm^2 in Gy: J per keV, g per kg, mm^2 per cm^2."""


ENERGIES = 5
"""Number of energy bins of a spectrum."""


class DoseGoal(LessIsBetter):
    """Primary kerma in a part: less is better. Scattered photons are ignored."""

    part: str = Field(description="Name of the part.")


def primary_kerma(
    geometry: ScanGeometry,
    points: ArrayLike,
    attenuation: Volume,
    *,
    energy_kev: float,
    photons_per_mm2: float,
    absorption_cm2_g: float,
) -> Floats:
    """Compute the mean primary kerma of a part's points in each view, Gy, at one energy.

    The beam is collimated to the panel: points outside the projection get no dose.

    Args:
        geometry: views.
        points: points of the part, (points, 3), mm.
        attenuation: the patient at this energy, 1/mm, entirely inside a coarse grid.
        energy_kev: photon energy E.
        photons_per_mm2: n mAs, photons of the unattenuated beam at 1 m.
        absorption_cm2_g: mu_en / rho of the part, see ``Material.absorption_cm2_g``.

    Returns:
        (views,).
    """
    points = np.atleast_2d(np.asarray(points, dtype=np.float64))
    grid, inside = attenuation.grid, sees(geometry, points)
    step = float(grid.voxel.min()) / 2
    # The diagonal is the longest path through the grid.
    reach = float(np.linalg.norm(grid.size_mm))
    kerma = np.zeros(len(geometry))
    for view in np.flatnonzero(inside.any(axis=1)).tolist():
        source, seen = geometry.source[view], points[inside[view]]
        way = grid.world_from_grid.inverse().apply(
            samples_towards(seen, source, reach, step).reshape(-1, 3)
        )
        index = ((way - grid.first_voxel_mm) / grid.voxel)[:, ::-1].T
        mu = scipy.ndimage.map_coordinates(
            attenuation.array, index, order=1, mode="constant", output=np.float64
        )
        depth = mu.reshape(len(seen), -1).sum(axis=1) * step
        square = ((source - seen) ** 2).sum(axis=1)
        kerma[view] = (1e6 / square * np.exp(-depth)).sum() / len(points)
    return kerma * photons_per_mm2 * energy_kev * absorption_cm2_g * GY_MM2


def _measure(settings: DoseGoal, views: Views, patient: PatientModel) -> Mean:
    """Return the mean primary kerma of the views, Gy."""
    energies, photons = patient.beam(ENERGIES, "task.dose")
    points, substance = patient.points_of(settings.part), patient.material_of(settings.part)
    kerma = np.zeros(len(views.geometry))
    for energy, per_mm2 in zip(energies.tolist(), photons.tolist(), strict=True):
        kerma += primary_kerma(
            views.geometry,
            points,
            patient.attenuation(energy),
            energy_kev=energy,
            photons_per_mm2=per_mm2,
            absorption_cm2_g=substance.absorption_cm2_g(energy),
        )
    return Mean(kerma)


def _with_exposures(
    settings: DoseGoal, kerma: Mean, views: Sequence[int], blur_mm: float, exposures: Floats
) -> float:
    return float((exposures * kerma.each[list(views)]).mean())


DOSE = Objective(
    "dose",
    DoseGoal,
    _measure,
    "Favour a low dose.",
    unit=lambda own: "Gy",
    conflicts=lambda own, parts: unknown_parts({"task.dose.part": own.part}, parts),
    under_errors=_with_exposures,
)
