"""Commands that run or show simulations."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Literal

import tyro

from twinct.cli.arguments import (
    LOOPBACK,
    PAGE_PORT,
    Flag,
    Host,
    Json,
    Network,
    Overrides,
    Port,
    ScenarioFile,
    Threads,
)
from twinct.cli.json_answer import answering
from twinct.cli.progress import on_terminal
from twinct.cli.summary import say_result


def run(
    scenario: ScenarioFile,
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    link: Literal["ros2", "local"] | None = None,
    resume: Flag = False,
    record: Flag = False,
    view: Flag = False,
    host: Host = LOOPBACK,
    port: Port = PAGE_PORT,
    allow_network: Network = False,
    threads: Threads = None,
    as_json: Json = False,
    set_: Overrides = (),
) -> None:
    """Run a scenario: plan, move, expose, reconstruct, evaluate, report.

    Writes scan.zarr, volume.nii, metrics.json, report.html and twinct.log into DIR.

    Args:
        out: Folder for the results; an existing scan is never changed without --resume.
        link: ros2 starts both simulations as processes; local runs them in this process. Default:
            ros2 if it is installed.
        resume: Resume an interrupted scan.
        record: Write all messages of the scan to DIR/scan.mcap, which ROS tools read.
        view: Show the run on a page while it runs (see twinct view); after the run, the page stays
            until Ctrl-C.
    """
    from twinct.scenario import load_scenario, named_places

    with answering(as_json) as answer, ExitStack() as page:
        loaded = load_scenario(scenario, set_)
        from twinct import runs  # a mistake in the scenario is told without waiting for this
        from twinct.cli.view import live_page
        from twinct.scan import SimulationBuilder

        live, builder = [], None
        if view:
            builder = SimulationBuilder(loaded)  # shared by page and run, so that it is built once
            viewer = live_page(out, builder, host, port, allow_network)
            live = [page.enter_context(viewer).observer]
        with named_places(scenario, set_), on_terminal(live) as audience:
            finished = runs.run(
                loaded,
                out,
                link=link,
                resume=resume,
                record=record,
                threads=threads,
                builder=builder,
                observers=audience,
            )
        say_result(finished)
        answer |= {"report": str(finished.paths.report), "figures": finished.figures}


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
    from twinct.cli.view import view_command

    view_command(targets, host, port, allow_network, export, movie, set_)


def node(
    which: Annotated[
        tyro.conf.Positional[Literal["robots", "xray"]], tyro.conf.arg(metavar="{robots,xray}")
    ],
    scenario: ScenarioFile,
    *,
    set_: Overrides = (),
) -> None:
    """Start one simulation as a separate ROS 2 node, until it is interrupted.

    The robots node receives targets on /scan/target and answers on /scan/reached; the xray node
    receives /scan/reached and answers on /xray/image.

    Args:
        which: The robot simulation or the X-ray simulation.
    """
    from twinct.core.extras import require
    from twinct.link import spin_robots, spin_xray
    from twinct.runs import check_physics
    from twinct.scan import SimulationBuilder
    from twinct.scenario import load_scenario, named_places
    from twinct.xray.engines import engine_extras

    loaded = load_scenario(scenario, set_)
    with named_places(scenario, set_):
        if which == "xray":
            require(*engine_extras(loaded.engine))
            check_physics(SimulationBuilder(loaded))
        elif loaded.cell.kind == "arms":
            require("robots")
        code = spin_robots(loaded) if which == "robots" else spin_xray(loaded)
    if code:
        sys.exit(code)
