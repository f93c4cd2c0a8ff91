"""Effects of a scenario's errors on its geometry, and on the task of its views."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twinct.core.arguments import kinds_checked
from twinct.core.extras import require
from twinct.core.files.writing import check_folder, complete, storage_errors, write_text
from twinct.geometry import Floats
from twinct.observers import Observers, audience_of
from twinct.report.errors import errors_picture
from twinct.runs.propagating import errors_of, figures, propagation_data
from twinct.runs.remedies import explained
from twinct.scan import SimulationBuilder
from twinct.scenario import Scenario, as_scenario
from twinct.uncertainty.propagation import Propagation
from twinct.view_plans.goals_with_errors import Rejudged, rejudged

TASK_DRAWS = 5
"""Most scans for which a task is evaluated: each takes as long as the measures of a plan."""


@dataclass(frozen=True, eq=False)
class Effects:
    """Effects of a scenario's errors.

    Attributes:
        propagation: errors of poses and images; None for calibrated arms: no other arms are drawn.
        goals: goals of the scenario's task with and without errors, by name; None without a task.
        blur_mm: blur of the task's region in each drawn scan, mm; None without a task.
        data: all of it as plain data.
    """

    propagation: Propagation | None
    goals: Mapping[str, Rejudged] | None
    blur_mm: Floats | None
    data: Mapping[str, Any]


@kinds_checked
def effects_of_errors(
    scenario: Scenario | str | Path,
    *,
    draws: int = 1000,
    out: str | Path | None = None,
    picture: str | Path | None = None,
    observers: Observers = (),
) -> Effects:
    """Compute the effects of a scenario's errors on poses and images, by cause, without rendering.

    Args:
        scenario: the scenario, or its file.
        draws: number of scans to draw.
        out: folder for uncertainty.json, with all covariances, and uncertainty.png.
        picture: file for the picture of an infeasible view.
        observers: notified of the progress.

    Raises:
        InputError: fewer than two draws.
        MissingExtraError: the extra ``robots`` is needed and not installed.
        TrajectoryError: a view is out of reach or would collide.
        StorageError: the folder cannot be written.
    """
    scenario = as_scenario(scenario)
    if scenario.cell.kind == "arms":
        require("robots")
    if out is not None:
        check_folder(out := Path(out))
    builder = SimulationBuilder(scenario)
    propagation, goals, blur_mm = None, None, None
    data: dict[str, Any] = {}
    file = None if picture is None else Path(picture)
    with audience_of(observers) as audience, explained(builder, file, progress=audience):
        if not (scenario.uncertainty.calibration and scenario.task):
            propagation = errors_of(builder, draws)
            data = propagation_data(propagation, builder)
        if scenario.task is not None:
            goals, blur_mm = rejudged(builder, min(draws, TASK_DRAWS), audience)
            data["task"] = {
                "blur_mm": blur_mm.tolist(),
                "goals": {
                    name: {"commanded": goal.commanded, "drawn": goal.drawn.tolist()}
                    for name, goal in goals.items()
                },
            }
    if out is not None:
        with storage_errors(out):
            out.mkdir(parents=True, exist_ok=True)
            write_text(out / "uncertainty.json", json.dumps(data) + "\n")
            if propagation is not None:
                title = f"{scenario.name}: executed minus believed"
                drawn = errors_picture(figures(propagation), propagation.shares(), title)
                with complete(out / "uncertainty.png") as draft:
                    draft.write_bytes(drawn.content)
    return Effects(propagation, goals, blur_mm, data)
