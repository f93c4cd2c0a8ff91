"""``twinct reconstruct``: further volumes of a scan."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from twinct.cli.arguments import Flag, Overrides, Threads
from twinct.cli.progress import on_terminal, say
from twinct.core.threads import limit_threads
from twinct.evaluation.figure import REFERENCE
from twinct.runs import reconstruct_run
from twinct.runs.folder import read_metrics
from twinct.scenario import named_places


def reconstruct(
    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")],
    *,
    geometry: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None,
    as_: Annotated[str | None, tyro.conf.arg(name="as", metavar="NAME")] = None,
    threads: Threads = None,
    halves: Flag = False,
    set_: Overrides = (),
) -> None:
    """Reconstruct a finished run again, beside its volume, and show both in its report.

    Or reconstruct a measured scan, and judge the volume by the figures that need no truth.

    Args:
        folder: Folder of twinct run --out, or of twinct import of a measured scan.
        geometry: commanded, executed, believed, or one made by twinct geometry.
        as_: Name of the result, below DIR/reconstructions; by default, it follows the algorithm.
        halves: For a measured scan: also reconstruct the even and the odd views, for the noise.
    """
    limit_threads(threads)
    how = {"geometry": geometry, "name": as_, "halves": halves}
    with named_places(folder / "scenario.yaml", set_), on_terminal() as audience:
        made = reconstruct_run(folder, set_, **how, observers=audience)
    material = read_metrics(folder / "metrics.json").get("reference_material", REFERENCE)
    say(f"{made.judged_in_words(material)}\n{made.path}; report: {folder / 'report.html'}")
