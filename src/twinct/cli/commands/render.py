"""``twinct render``: a picture of the room."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from twinct.cli.arguments import Overrides, ScenarioFile
from twinct.cli.progress import say
from twinct.cli.scenario_at import scenario_at
from twinct.runs.scenario_files import draw_view


def render(
    scenario: ScenarioFile,
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="PNG")] = Path("room.png"),
    view: Annotated[
        int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="(default: the middle one)")
    ] = None,
    width: int = 1600,
    height: int = 1000,
    set_: Overrides = (),
) -> None:
    """Draw the operating room at one view.

    An infeasible view is drawn, too: collisions in red, a source or panel out of reach as a ghost
    at its target, and its arm in the nearest configuration.

    Args:
        out: File to write.
        view: View at which source and panel are drawn.
        width: Width of the picture in pixels.
        height: Height of the picture in pixels.
    """
    with scenario_at(scenario, set_) as loaded:
        problems = draw_view(loaded, out, view=view, width=width, height=height)
    for problem in problems:
        say(problem, warning=True)
    Console().print(f"wrote {out}", highlight=False)
