"""The command ``uncertainty``: effects of a scenario's errors on its geometry."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from twinct.cli.progress import on_terminal
from twinct.cli.reach import explained
from twinct.core.extras import require
from twinct.core.files.writing import check_folder, complete, storage_errors, write_text
from twinct.core.foreign_text import counted
from twinct.core.progress import Progress
from twinct.report.errors import errors_picture
from twinct.runs.propagating import errors_of, figures, propagation_data, summary
from twinct.scan import SimulationBuilder
from twinct.scenario import load_scenario, named_places
from twinct.uncertainty.propagation import Propagation

UNITS = {"mm": "mm", "deg": "deg", "px": "px"}

TASK_DRAWS = 5
"""Most scans for which a task is evaluated: each takes as long as the measures of a plan."""


def uncertainty_command(
    scenario: Path, set_: Sequence[str], draws: int, out: Path | None, picture: Path
) -> dict[str, Any]:
    """Propagate errors, print two tables, return the numbers, and write them to ``out``."""
    loaded = load_scenario(scenario, set_)
    if loaded.cell.kind == "arms":
        require("robots")
    if out is not None:
        check_folder(out)
    builder = SimulationBuilder(loaded)
    data: dict[str, Any] = {}
    drawn = None
    # With calibrated arms, no other arms are drawn.
    if not (loaded.uncertainty.calibration and loaded.task):
        with named_places(scenario, set_), explained(builder, picture):
            propagation = errors_of(builder, draws)
        rows = _of_poses(
            propagation, f"{loaded.name}: executed minus believed, {counted(draws, 'draw')}"
        )
        data = propagation_data(propagation, builder)
        drawn = errors_picture(
            figures(propagation), rows, f"{loaded.name}: executed minus believed"
        )
    if loaded.task is not None:
        with (
            named_places(scenario, set_),
            on_terminal() as audience,
            explained(builder, picture),
        ):
            data["task"] = _of_the_task(builder, min(draws, TASK_DRAWS), audience)
    if out is None:
        return data
    with storage_errors(out):
        out.mkdir(parents=True, exist_ok=True)
        write_text(out / "uncertainty.json", json.dumps(data) + "\n")
        if drawn is not None:
            with complete(out / "uncertainty.png") as draft:
                draft.write_bytes(drawn.content)
    Console().print(f"wrote {out}", highlight=False)
    return data


def _of_poses(propagation: Propagation, title: str) -> list[dict[str, Any]]:
    """Print the effects of the errors on poses and images, and their causes; return the causes."""
    table = Table(title=f"{title} of {propagation.errors.shape[1]} views")
    for name in ("", "mean", "median", "95 %", "largest"):
        table.add_column(name)
    for name, spread in summary(propagation).items():
        values = (spread[key] for key in ("mean", "median", "p95", "max"))
        what, unit = name.rsplit("_", 1)
        table.add_row(f"{what}, {UNITS[unit]}", *(f"{value:.3f}" for value in values))
    Console().print(table)
    rows = propagation.shares()
    table = Table(title="each cause alone, to first order, RMS")
    names = [name for name in rows[0] if name != "term"] if rows else []
    for name in ("cause", *(name.replace("_", "\n") for name in names)):
        table.add_column(name)
    for row in rows:
        table.add_row(str(row["term"]), *(f"{row[name]:.3f}" for name in names))
    Console().print(table)
    return rows


def _of_the_task(builder: SimulationBuilder, draws: int, progress: Progress) -> dict[str, Any]:
    """Print, and return, the effects of the errors on the task of the views."""
    from twinct.view_plans.goals_with_errors import rejudged

    task = builder.scenario.task
    assert task is not None
    judged, blur_mm = rejudged(builder, draws, progress)
    table = Table(
        title=f"effect on the task: {counted(draws, 'scan')}, blurred by {blur_mm.mean():.3f} mm "
        "in the region"
    )
    for name in ("", "as planned", "mean", "smallest", "largest"):
        table.add_column(name)
    for name, goal in judged.items():
        values = (goal.commanded, goal.drawn.mean(), goal.drawn.min(), goal.drawn.max())
        table.add_row(task.label(name), *(f"{value:.4g}" for value in values))
    Console().print(table)
    goals = {
        name: {"commanded": goal.commanded, "drawn": goal.drawn.tolist()}
        for name, goal in judged.items()
    }
    return {"blur_mm": blur_mm.tolist(), "goals": goals}
