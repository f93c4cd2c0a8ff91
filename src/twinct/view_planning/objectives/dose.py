"""Dose of each view to a part of the patient, with scattered photons.

Unscattered photons give their dose along rays in each view. That of scattered ones is simulated for
a few views, once, and interpolated (``twinct.xray.view_nodes``): another view costs its rays only.
"""

from __future__ import annotations

from collections.abc import Sequence

from pydantic import Field

from twinct.core.settings import setting
from twinct.geometry import Floats
from twinct.view_planning.objectives.measures import Mean
from twinct.view_planning.objectives.objective import (
    LessIsBetter,
    Objective,
    PatientModel,
    Views,
    unknown_parts,
)


class DoseGoal(LessIsBetter):
    """Mean dose of a part, with scattered photons: less is better."""

    part: str = Field(description="Name of the part.")
    photons: int = setting(
        1_000_000, "Photons of each simulated view.", ge=1000, le=10**12, unit="photons"
    )
    views: int = setting(32, "Views in which scattered photons are simulated.", ge=1, le=10_000)
    voxel_mm: float = setting(
        2.0, "Edge of the voxels that stand for the specimen.", gt=0, unit="mm"
    )


def _measure(settings: DoseGoal, views: Views, patient: PatientModel) -> Mean:
    """Return the mean dose of the part in each view, Gy."""
    return Mean(
        patient.doses(
            views,
            settings.part,
            photons=settings.photons,
            simulated=settings.views,
            voxel_mm=settings.voxel_mm,
            key="task.dose",
        )
    )


def _with_exposures(
    settings: DoseGoal, dose: Mean, views: Sequence[int], blur_mm: float, exposures: Floats
) -> float:
    return float((exposures * dose.each[list(views)]).mean())


DOSE = Objective(
    "dose",
    DoseGoal,
    _measure,
    "Favour a low dose.",
    unit=lambda own: "Gy",
    conflicts=lambda own, parts: unknown_parts({"task.dose.part": own.part}, parts),
    under_errors=_with_exposures,
)
