"""Which views are worth taking: objectives over a region, and the choice among candidates."""

from twinct.planning.completeness import crossed_planes, local_completeness, plane_normals
from twinct.planning.detectability import Detectability, Task, detectability_of
from twinct.planning.dose import primary_kerma
from twinct.planning.metal import metal_paths, starved_share
from twinct.planning.selection import Choice, covered_share, exact_choice, exchanged, greedy_choice

__all__ = [
    "Choice",
    "Detectability",
    "Task",
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
    "starved_share",
]
