"""``twinct reach``: directions that the arms can reach."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.table import Table

from twinct.cli.arguments import Flag, Json, Overrides, ScenarioFile
from twinct.cli.json_answer import answering
from twinct.cli.progress import on_terminal
from twinct.cli.scenario_at import scenario_at
from twinct.robots.reach.results import shares
from twinct.runs import reaching


def reach(
    scenario: ScenarioFile,
    *,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    radii: Annotated[tuple[float, ...], tyro.conf.arg(metavar="MM")] = (),
    odd: Annotated[float | None, tyro.conf.arg(metavar="MM")] = None,
    directions: int = 1000,
    connected: Flag = False,
    as_json: Json = False,
    set_: Overrides = (),
) -> None:
    """Show which directions source and panel can reach, all over the sphere, at one or more radii.

    Source and panel may be turned about the beam.

    Args:
        out: Folder for reach.json, reach.csv, and pictures of the sphere and of the room.
        radii: Distances from the isocentre to the source (default: the scenario's).
        odd: Distance from the isocentre to the panel (default: the scenario's).
        directions: Number of directions.
        connected: Also search for collision-free paths between directions, which takes minutes.
    """
    with answering(as_json) as answer:
        with scenario_at(scenario, set_) as loaded, on_terminal() as audience:
            result = reaching.reach(
                loaded,
                out=out,
                radii_mm=radii,
                odd_mm=odd,
                directions=directions,
                connected=connected,
                observers=audience,
            )
        rows = shares(result)
        table = Table(title=f"{loaded.name}: share of {directions} directions")
        table.add_column("SOD, mm")
        names = [n for n in ("source", "detector", "both", "connected") if f"{n}_share" in rows[0]]
        for name in (*names, "median clearance", "median joint margin"):
            table.add_column(name)
        for row in rows:
            figures = [f"{100 * row[f'{name}_share']:.1f} %" for name in names]
            gap, margin = row.get("median_clearance_mm"), row.get("median_margin_deg")
            figures += ["-" if gap is None else f"{gap:.1f} mm"]
            figures += ["-" if margin is None else f"{margin:.0f} deg"]
            table.add_row(f"{row['sod_mm']:g}", *figures)
        Console().print(table)
        if out is not None:
            Console().print(f"wrote {out}", highlight=False)
        answer |= {"directions": directions, "shares": rows}
