"""``twinct view``: the page of a run or a scenario."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from twinct.cli.arguments import LOOPBACK, PAGE_PORT, Host, Network, Overrides, Port
from twinct.core.errors import InputError
from twinct.core.extras import require
from twinct.core.files.writing import check_film, check_page
from twinct.core.foreign_text import counted

MOST_RUNS = 2


def view(
    targets: Annotated[
        tyro.conf.Positional[tuple[Path, ...]],
        tyro.conf.arg(
            metavar="SCENARIO|DIR",
            help="Scenario file, or folder of twinct run or import; two folders: side by side.",
        ),
    ],
    *,
    host: Host = LOOPBACK,
    port: Port = PAGE_PORT,
    allow_network: Network = False,
    export: Annotated[Path | None, tyro.conf.arg(metavar="HTML")] = None,
    movie: Annotated[Path | None, tyro.conf.arg(metavar="MP4")] = None,
    set_: Overrides = (),
) -> None:
    """Show a run in a browser: room, beam, images, volume, errors; also while it runs.

    For a scenario that has not been run, the page shows room, plan, reach and field of view.

    Args:
        export: Write a page that needs no server instead: it plays all views, with a free camera.
        movie: Write a film of the scan instead.
    """
    if not 1 <= len(targets) <= MOST_RUNS:
        raise InputError(
            f"{counted(len(targets), 'folder')}: the page shows one, or two side by side"
        )
    if export is not None:
        check_page(export, "--export")
    if movie is not None:
        check_film(movie, "--movie")
    require("view", "robots")
    from twinct.cli.live_page import show_runs, show_scenario  # viser is optional, and slow

    where, files = (host, port, allow_network), (export, movie)
    if len(targets) == 1 and not targets[0].is_dir():
        show_scenario(targets[0], set_, *where, files)
        return
    if set_:
        raise InputError(f"--set {set_[0]}: only a scenario takes --set; a run is shown as it is")
    show_runs(targets, *where, files)
