"""The command ``uncertainty``: what a scenario's errors do to its geometry."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from twinct.cli.reach import explained
from twinct.extras import require
from twinct.files.writing import check_folder, storage_errors, write_text
from twinct.report.errors import errors_picture
from twinct.runs.propagating import errors_of, figures, summary, told_errors
from twinct.scan import Workshop
from twinct.scenario import load_scenario, named_places

UNITS = {"mm": "mm", "deg": "deg", "px": "px"}


def uncertainty_command(
    scenario: Path, set_: Sequence[str], draws: int, out: Path | None, picture: Path
) -> None:
    """Propagate, print two tables, and write numbers and picture where a folder is named."""
    loaded = load_scenario(scenario, set_)
    if loaded.cell.kind == "arms":
        require("robots")
    if out is not None:
        check_folder(out)
    workshop = Workshop(loaded)
    with named_places(scenario, set_), explained(workshop, picture):
        found = errors_of(workshop, draws)
    views = found.errors.shape[1]
    table = Table(title=f"{loaded.name}: executed less believed, {draws} draws of {views} views")
    for name in ("", "mean", "median", "95 %", "largest"):
        table.add_column(name)
    for name, spread in summary(found).items():
        told = (spread[key] for key in ("mean", "median", "p95", "max"))
        what, unit = name.rsplit("_", 1)
        table.add_row(f"{what}, {UNITS[unit]}", *(f"{value:.3f}" for value in told))
    Console().print(table)
    rows = found.shares()
    table = Table(title="each cause alone, to first order, RMS")
    names = [name for name in rows[0] if name != "term"] if rows else []
    for name in ("cause", *(name.replace("_", "\n") for name in names)):
        table.add_column(name)
    for row in rows:
        table.add_row(str(row["term"]), *(f"{row[name]:.3f}" for name in names))
    Console().print(table)
    if out is None:
        return
    with storage_errors(out):
        out.mkdir(parents=True, exist_ok=True)
        write_text(out / "uncertainty.json", json.dumps(told_errors(found, workshop)) + "\n")
        drawn = errors_picture(figures(found), rows, f"{loaded.name}: executed less believed")
        (out / "uncertainty.png").write_bytes(drawn.content)
    Console().print(f"wrote {out}", highlight=False)
