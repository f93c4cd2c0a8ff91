"""All objectives by name, built in or from extensions."""

from __future__ import annotations

from functools import cache
from typing import Any

from twinct.core.extensions import Registry
from twinct.recon.objectives.completeness import COMPLETENESS
from twinct.recon.objectives.detectability import DETECTABILITY
from twinct.recon.objectives.dose import DOSE
from twinct.recon.objectives.metal_paths import METAL
from twinct.recon.objectives.motion_time import MOVING
from twinct.recon.objectives.objective import Objective
from twinct.recon.objectives.variance import KNOWN

BUILT_IN: dict[str, Objective[Any]] = {
    objective.name: objective
    for objective in (COMPLETENESS, DETECTABILITY, KNOWN, METAL, DOSE, MOVING)
}


@cache
def objectives() -> Registry[Objective[Any]]:
    """Return the objectives that a task can name; they are looked up once per process."""
    return Registry("twinct.objectives", Objective, BUILT_IN)
