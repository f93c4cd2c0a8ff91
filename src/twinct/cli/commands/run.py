"""``twinct run``: a scenario, from the plan to the report."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Literal

import tyro

from twinct import runs
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
from twinct.cli.scenario_at import scenario_at
from twinct.cli.summary import say_result
from twinct.scan import SimulationBuilder


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
    with answering(as_json) as answer, ExitStack() as page:
        with scenario_at(scenario, set_) as loaded:
            live, builder = [], None
            if view:
                from twinct.cli.live_page import live_page  # viser is optional

                builder = SimulationBuilder(loaded)  # shared by page and run: it is built once
                viewer = live_page(out, builder, host, port, allow_network)
                live = [page.enter_context(viewer).observer]
            with on_terminal(live) as audience:
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
