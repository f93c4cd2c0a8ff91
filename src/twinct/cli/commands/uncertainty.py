"""``twinct uncertainty``: effects of errors on poses, images and task."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.table import Table

from twinct.cli.arguments import Json, Overrides, ScenarioFile
from twinct.cli.json_answer import answering
from twinct.cli.progress import on_terminal
from twinct.cli.scenario_at import scenario_at
from twinct.core.foreign_text import counted
from twinct.runs.propagating import summary
from twinct.scenario import ViewTask
from twinct.uncertainty.propagation import Propagation
from twinct.view_plans.effects import Effects, effects_of_errors

UNITS = {"mm": "mm", "deg": "deg", "px": "px"}


def uncertainty(
    scenario: ScenarioFile,
    *,
    draws: int = 1000,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    picture: Annotated[Path, tyro.conf.arg(metavar="PNG")] = Path("view.png"),
    as_json: Json = False,
    set_: Overrides = (),
) -> None:
    """Compute the effects of a scenario's errors, without rendering.

    They are those on poses and images, by cause, and on the task of the views.

    Args:
        draws: Number of scans to draw.
        out: Folder for uncertainty.json, with all covariances, and uncertainty.png.
        picture: File for the picture of an infeasible view.
    """
    with answering(as_json) as answer:
        with scenario_at(scenario, set_) as loaded, on_terminal() as audience:
            found = effects_of_errors(
                loaded, draws=draws, out=out, picture=picture, observers=audience
            )
        if found.propagation is not None:
            title = f"{loaded.name}: executed minus believed, {counted(draws, 'draw')}"
            _show_poses(found.propagation, title)
        if loaded.task is not None:
            _show_task(found, loaded.task)
        if out is not None:
            Console().print(f"wrote {out}", highlight=False)
        answer |= found.data


def _show_poses(propagation: Propagation, title: str) -> None:
    """Print the effects of the errors on poses and images, and their causes."""
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


def _show_task(found: Effects, task: ViewTask) -> None:
    """Print the effects of the errors on the task of the views."""
    assert found.goals is not None and found.blur_mm is not None
    table = Table(
        title=f"effect on the task: {counted(len(found.blur_mm), 'scan')}, blurred by "
        f"{found.blur_mm.mean():.3f} mm in the region"
    )
    for name in ("", "as planned", "mean", "smallest", "largest"):
        table.add_column(name)
    for name, goal in found.goals.items():
        values = (goal.commanded, goal.drawn.mean(), goal.drawn.min(), goal.drawn.max())
        table.add_row(task.label(name), *(f"{value:.4g}" for value in values))
    Console().print(table)
