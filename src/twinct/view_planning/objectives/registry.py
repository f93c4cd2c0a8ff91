"""All objectives by name, built in or from extensions."""

from __future__ import annotations

from functools import cache
from typing import Any

from twinct.core.extensions import Registry
from twinct.view_planning.objectives.completeness import COMPLETENESS
from twinct.view_planning.objectives.detectability import DETECTABILITY
from twinct.view_planning.objectives.dose import DOSE
from twinct.view_planning.objectives.metal_paths import METAL
from twinct.view_planning.objectives.motion_time import MOVING
from twinct.view_planning.objectives.objective import Objective
from twinct.view_planning.objectives.variance import KNOWN

BUILT_IN: dict[str, Objective[Any]] = {
    objective.name: objective
    for objective in (COMPLETENESS, DETECTABILITY, KNOWN, METAL, DOSE, MOVING)
}


@cache
def objectives() -> Registry[Objective[Any]]:
    """Return the objectives that a task can name; they are looked up once per process."""
    return Registry("twinct.objectives", Objective, BUILT_IN)
