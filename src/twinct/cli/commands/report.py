"""``twinct report``: figures and report of a run made anew."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from twinct.cli.arguments import Json, Overrides
from twinct.cli.json_answer import answering
from twinct.cli.progress import on_terminal
from twinct.cli.summary import say_result
from twinct.runs import rewrite_report
from twinct.scenario import named_places


def report(
    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")],
    *,
    as_json: Json = False,
    set_: Overrides = (),
) -> None:
    """Evaluate a finished run again and rewrite its metrics.json and report.html.

    --set evaluation.KEY=VALUE adds measurements in its volumes; none is reconstructed again. For
    a measured scan, all volumes are judged again by the figures that need no truth.

    Args:
        folder: Folder of twinct run --out, or of twinct import of a measured scan.
    """
    with answering(as_json) as answer:
        with named_places(folder / "scenario.yaml", set_), on_terminal() as audience:
            again = rewrite_report(folder, audience, set_)
        say_result(again)
        answer |= {"report": str(again.paths.report), "figures": again.figures}
