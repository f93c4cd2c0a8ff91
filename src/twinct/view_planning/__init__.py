"""View planning: objectives over a region, and the choice of views among candidates."""

from twinct.view_planning.exact_choice import Choice, covered_share, exact_choice
from twinct.view_planning.exposure import best_exposures
from twinct.view_planning.family import Tuned, best_parameters
from twinct.view_planning.goals import Goal, worth_of
from twinct.view_planning.objectives.completeness import (
    crossed_planes,
    local_completeness,
    plane_normals,
)
from twinct.view_planning.objectives.detectability import Detectability, Task, detectability_of
from twinct.view_planning.objectives.measures import Coverage, Mean, Measure
from twinct.view_planning.objectives.metal_paths import metal_paths, spectral_shift, starved_share
from twinct.view_planning.objectives.motion_time import PathTime, TourTime
from twinct.view_planning.objectives.variance import KnownShare, prior_covariance
from twinct.view_planning.prices import has_limit
from twinct.view_planning.reasons import Reason, best_alone, reasons_of
from twinct.view_planning.search import Searched, search_views

__all__ = [
    "Choice",
    "Coverage",
    "Detectability",
    "Goal",
    "Mean",
    "Measure",
    "PathTime",
    "Reason",
    "Searched",
    "Task",
    "TourTime",
    "Tuned",
    "best_alone",
    "best_exposures",
    "best_parameters",
    "KnownShare",
    "covered_share",
    "crossed_planes",
    "detectability_of",
    "exact_choice",
    "has_limit",
    "local_completeness",
    "metal_paths",
    "plane_normals",
    "reasons_of",
    "search_views",
    "spectral_shift",
    "starved_share",
    "worth_of",
    "prior_covariance",
]
