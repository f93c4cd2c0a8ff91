"""The command that plans views for a task."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from twinct.cli.progress import on_terminal
from twinct.extras import require
from twinct.scenario import load_scenario, named_places
from twinct.threads import limit_threads


def plan_command(
    scenario: Path, set_: Sequence[str], out: Path, resume: bool, threads: int | None
) -> None:
    """Plan, and print what the views are worth."""
    from twinct.runs.view_plan import SCENARIO, plan_views

    limit_threads(threads)
    if load_scenario(scenario, set_).cell.kind == "arms":
        require("robots")
    with named_places(scenario, set_), on_terminal() as audience:
        found = plan_views(scenario, out, set_, resume=resume, progress=audience)
    table = Table(
        title=f"{len(found.views)} views of {found.reachable} within reach of {found.candidates}"
    )
    for name in ("", "planned", "spread evenly", "the scenario's path"):
        table.add_column(name)
    for name, figures in found.figures.items():
        table.add_row(name, *(f"{value:.4g}" for value in figures.values()))
    console = Console()
    console.print(table)
    if found.scan_s is not None:
        motion = f"motion {found.scan_s:.1f} s, smallest clearance {found.clearance_mm:.1f} mm"
        console.print(motion, highlight=False)
    console.print(f"wrote {out}; twinct run {out / SCENARIO} takes these views", highlight=False)
