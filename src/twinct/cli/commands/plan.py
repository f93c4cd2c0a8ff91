"""``twinct plan``: views for a task."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.table import Table

from twinct.cli.arguments import Flag, Overrides, ScenarioFile, Threads
from twinct.cli.progress import on_terminal
from twinct.cli.scenario_at import scenario_at
from twinct.core.foreign_text import counted
from twinct.scenario import ViewTask
from twinct.view_plans import planner


def plan(
    scenario: ScenarioFile,
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    scout: Annotated[Path | None, tyro.conf.arg(metavar="RUN")] = None,
    try_views: Annotated[Flag, tyro.conf.arg(name="try")] = False,
    explain: Flag = False,
    address: Annotated[str | None, tyro.conf.arg(metavar="auto|local|HOST:PORT")] = None,
    jobs: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    resume: Flag = False,
    threads: Threads = None,
    set_: Overrides = (),
) -> None:
    """Choose views for the section task of a scenario, among the views that the arms can reach.

    Writes views.csv, planned.yaml (which twinct run executes), plan.npz, plan.json and plan.png.

    Args:
        out: Folder for the results.
        scout: Run of a few views, used to locate the specimen before planning.
        try_views: Simulate images of the planned views and of the scenario's path, and compare
            the volumes in tried.png.
        explain: Write why each view was chosen and what was given up (explained.csv and
            explained.png), and draw the path in the room (path.png). With --resume, for a finished
            plan, too.
        address: Address of Ray; local starts Ray on this machine. Default: local processes.
        jobs: Processes that search for reachable views and evaluate paths of a family (default: as
            many as there are threads).
        resume: Resume an interrupted search.
    """
    with scenario_at(scenario, set_) as loaded, on_terminal() as audience:
        plan = planner.plan(
            scenario,
            out,
            set_,
            scout=scout,
            try_views=try_views,
            explain=explain,
            resume=resume,
            address=address,
            jobs=jobs,
            threads=threads,
            observers=audience,
        )
    table = Table(
        title=f"{counted(len(plan.views), 'view')}; "
        f"{plan.reachable} of {plan.candidates} candidates reachable"
    )
    for name in ("", "planned", "evenly spread", "the scenario's path"):
        table.add_column(name)
    assert loaded.task is not None
    for name, figures in plan.figures.items():
        label = loaded.task.label(name)
        table.add_row(
            label, *("-" if value is None else f"{value:.4g}" for value in figures.values())
        )
    console = Console()
    console.print(table)
    if (seen := plan.scouted) is not None:
        moved = f"{seen.moved_mm:.2f} mm and {seen.turned_deg:.2f} deg"
        console.print(
            f"registering {seen.views} scout views moved the specimen by {moved}", highlight=False
        )
    if plan.explained is not None:
        _explain(console, plan, loaded.task)
    if plan.tried is not None:
        names = {
            "planned": "planned",
            "spread_evenly": "evenly spread",
            "own_path": "on the scenario's path",
        }
        each = (f"{100 * plan.tried[key]:.2f} % {name}" for key, name in names.items())
        words = f"error in the region: {', '.join(each)}"
        console.print(words, highlight=False)
    if plan.scan_s is not None:
        motion = f"motion {plan.scan_s:.1f} s, smallest clearance {plan.clearance_mm:.1f} mm"
        console.print(motion, highlight=False)
    written = out / planner.SCENARIO
    console.print(f"wrote {out}; twinct run {written} takes these views", highlight=False)


def _explain(console: Console, plan: planner.ViewPlan, task: ViewTask) -> None:
    """Print what was given up, and the views that matter most and least."""
    found = plan.explained
    assert found is not None
    for name, best in found.alone.items():
        label, planned = task.label(name), plan.figures[name]["planned"]
        said = f"{label}: {planned:.4g} planned, {best:.4g} if this goal alone counted"
        console.print(said, highlight=False)
    ranked = sorted(range(len(found.reasons)), key=lambda view: -found.reasons[view].worth)
    for words, view in (("most", ranked[0]), ("least", ranked[-1])):
        reason, (longitude, latitude) = found.reasons[view], found.directions_deg[view].tolist()
        adds = reason.adds.items()
        changes = ", ".join(f"{name} {100 * by:+.2f} %" for name, by in adds)
        console.print(
            f"view {view} (longitude {longitude:.0f}, latitude {latitude:.0f} deg) adds {words}: "
            f"{changes} (of the figure of evenly spread views)",
            highlight=False,
        )
