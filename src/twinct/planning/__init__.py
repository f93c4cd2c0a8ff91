"""Which views are worth taking: objectives over a region, and the choice among candidates."""

from twinct.planning.completeness import crossed_planes, local_completeness, plane_normals
from twinct.planning.detectability import Detectability, Task, detectability_of
from twinct.planning.dose import primary_kerma
from twinct.planning.exposure import best_exposures
from twinct.planning.family import Tuned, best_parameters
from twinct.planning.goals import Coverage, Goal, Mean, Measure
from twinct.planning.metal import metal_paths, starved_share
from twinct.planning.search import Searched, search_views, worth_of
from twinct.planning.selection import Choice, covered_share, exact_choice, exchanged, greedy_choice
from twinct.planning.variance import KnownShare, prior_covariance

__all__ = [
    "Choice",
    "Coverage",
    "Detectability",
    "Goal",
    "Mean",
    "Measure",
    "Searched",
    "Task",
    "Tuned",
    "best_exposures",
    "best_parameters",
    "KnownShare",
    "covered_share",
    "crossed_planes",
    "detectability_of",
    "exact_choice",
    "exchanged",
    "greedy_choice",
    "local_completeness",
    "metal_paths",
    "plane_normals",
    "primary_kerma",
    "search_views",
    "starved_share",
    "worth_of",
    "prior_covariance",
]
