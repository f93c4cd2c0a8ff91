"""The command that plans views for a task."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rich.console import Console
from rich.table import Table

from twinct.cli.progress import on_terminal
from twinct.core.errors import InputError
from twinct.core.extras import require
from twinct.core.files.private import temporary_folder
from twinct.core.foreign_text import counted
from twinct.core.threads import limit_threads
from twinct.scenario import load_scenario, named_places
from twinct.workers import LocalPool, Pool


def plan_command(
    scenario: Path,
    set_: Sequence[str],
    out: Path,
    scout: Path | None,
    try_views: bool,
    address: str | None,
    jobs: int | None,
    resume: bool,
    threads: int | None,
) -> None:
    """Plan, and print the quality of the views."""
    from twinct.view_plans.planner import SCENARIO, plan_views

    if jobs is not None and jobs < 1:
        raise InputError(f"--jobs {jobs}: must be at least 1")
    bound = limit_threads(threads)
    loaded = load_scenario(scenario, set_)
    if loaded.cell.kind == "arms":
        require("robots")
    with (
        named_places(scenario, set_),
        on_terminal() as audience,
        _pool(address, jobs, bound) as pool,
    ):
        plan = plan_views(
            scenario,
            out,
            set_,
            scout=scout,
            try_views=try_views,
            resume=resume,
            pool=pool,
            progress=audience,
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
    if plan.tried is not None:
        own, planned = (100 * plan.tried[name] for name in ("own_path", "planned"))
        words = f"error in the region: {planned:.2f} % planned, {own:.2f} % on the scenario's path"
        console.print(words, highlight=False)
    if plan.scan_s is not None:
        motion = f"motion {plan.scan_s:.1f} s, smallest clearance {plan.clearance_mm:.1f} mm"
        console.print(motion, highlight=False)
    console.print(f"wrote {out}; twinct run {out / SCENARIO} takes these views", highlight=False)


@contextmanager
def _pool(address: str | None, jobs: int | None, bound: int) -> Iterator[Pool | None]:
    """Yield the pool of workers for a search, or None for a single thread; clean up afterwards."""
    workers = jobs or bound
    if address is None and workers == 1:
        yield None
        return
    with temporary_folder() as folder:
        if address is None:
            share = max(bound // workers, 1)
            pool: Pool = LocalPool(folder, workers=workers, threads=share)
        else:
            from twinct.workers.cluster import RayPool

            pool = RayPool(address, name=folder.name, workers=jobs)
        try:
            yield pool
        finally:
            pool.close(clear=True)
