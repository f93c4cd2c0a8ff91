"""Level beams: patients can be imaged from the side, with no arm above or below them."""

import numpy as np
from pydantic import Field

from twinct.view_planning.objectives import LessIsBetter, Mean, Objective, PatientModel, Views


class LevelGoal(LessIsBetter):
    """Angle between beam and floor: less is better."""

    free_deg: float = Field(default=0.0, ge=0, lt=90, description="Angle that costs nothing.")


def _measure(settings: LevelGoal, views: Views, patient: PatientModel) -> Mean:
    beam = views.points[0] - views.geometry.source
    angle = np.degrees(np.arcsin(np.abs(beam[:, 2]) / np.linalg.norm(beam, axis=1)))
    return Mean(np.maximum(angle - settings.free_deg, 0.0))


LEVEL = Objective("level", LevelGoal, _measure, "Keep the beam level.", unit=lambda settings: "deg")
