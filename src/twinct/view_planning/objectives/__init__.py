"""Objectives of view planning: what makes a choice of views a good one."""

from twinct.view_planning.objectives.measures import Coverage, Mean, Measure, figure_of
from twinct.view_planning.objectives.objective import (
    LessIsBetter,
    MoreIsBetter,
    Objective,
    PatientModel,
    Views,
    unknown_parts,
)
from twinct.view_planning.objectives.visibility import sees

__all__ = [
    "Coverage",
    "LessIsBetter",
    "Mean",
    "Measure",
    "MoreIsBetter",
    "Objective",
    "PatientModel",
    "Views",
    "figure_of",
    "sees",
    "unknown_parts",
]
