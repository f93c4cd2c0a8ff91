"""Goals of a scenario's task for candidate views, computed from a model of the patient."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from twinct.core.errors import InputError
from twinct.core.progress import Progress
from twinct.geometry import Floats, Pose, ScanGeometry, fibonacci_directions
from twinct.scan import SimulationBuilder
from twinct.scenario import ViewTask
from twinct.view_planning.goals import Goal
from twinct.view_planning.objectives import Mean, Measure, MoreIsBetter, Views, figure_of, sees
from twinct.view_plans.patient import Patient

POINTS = 12
"""Number of points on the region's surface, in addition to its centre."""


def region_points(task: ViewTask, world_from_specimen: Pose) -> Floats:
    """Return the centre of the task's region and points on its surface, world, (points, 3), mm."""
    around = task.radius_mm * fibonacci_directions(POINTS)
    points = np.vstack([np.zeros((1, 3)), around[: POINTS if task.radius_mm else 0]])
    return world_from_specimen.apply(points + np.asarray(task.position_mm))


def goals_of(
    builder: SimulationBuilder,
    geometry: ScanGeometry,
    candidates: int,
    even: Sequence[int],
    progress: Progress,
) -> list[Goal]:
    """Build the goals of the task, for views given by their index in a geometry.

    Args:
        builder: builder of a scenario with a task.
        geometry: candidates, followed by other views for comparison.
        candidates: number of candidates.
        even: evenly spread candidates; their measures are the units.
        progress: receives the progress.

    Raises:
        InputError: no view sees the region, or a goal needs a photon number that is not given.
    """
    task, patient = builder.scenario.task, Patient(builder)
    assert task is not None
    points = region_points(task, builder.specimen.world_from_specimen)
    if not sees(geometry[:candidates], points[:1]).any():
        x, y, z = points[0].tolist()
        raise InputError(
            f"task.position_mm: no reachable view sees the region at ({x:.0f}, {y:.0f}, {z:.0f}) "
            "mm in the world; every view sees the isocentre of the trajectory"
        )
    in_order = task.family is not None
    views = Views(geometry, even, points, task.radius_mm, in_order, progress)
    return [
        _goal(name, section, objective.measure(section, views, patient), even)
        for name, (objective, section) in task.goals.items()
    ]


def _goal(
    name: str, section: Any, made: Measure | tuple[Measure, Measure], even: Sequence[int]
) -> Goal:
    """Return the measure with the weight and the limits of its settings."""
    measure, of_even = made if isinstance(made, tuple) else (made, made)
    if isinstance(of_even, Mean):
        unit = float(of_even.each[list(even)].mean())
    else:
        unit = figure_of(of_even, even)
    if isinstance(section, MoreIsBetter):
        if not unit > 0:
            raise InputError(
                f"task.{name} is 0 for views spread evenly over all reachable ones, so relative "
                "values are undefined; if only few of them see the region, move it "
                "(task.position_mm): every view sees the isocentre of the trajectory"
            )
        least = None if section.at_least_rel is None else section.at_least_rel * unit
        return Goal(name, measure, section.weight, unit, at_least=least)
    limit = None if section.at_most_rel is None else section.at_most_rel * unit
    # If evenly spread views have zero cost, no other choice has much.
    return Goal(name, measure, -section.weight, unit or 1.0, limit)
