"""``twinct node``: one simulation as a ROS 2 node."""

from __future__ import annotations

import sys
from typing import Annotated, Literal

import tyro

from twinct import link
from twinct.cli.arguments import Overrides, ScenarioFile
from twinct.cli.scenario_at import scenario_at
from twinct.core.extras import require
from twinct.runs import check_physics
from twinct.scan import SimulationBuilder
from twinct.xray.engines import engine_extras


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
    with scenario_at(scenario, set_) as loaded:
        if which == "xray":
            require(*engine_extras(loaded.engine))
            check_physics(SimulationBuilder(loaded))
        elif loaded.cell.kind == "arms":
            require("robots")
        code = link.spin_robots(loaded) if which == "robots" else link.spin_xray(loaded)
    if code:
        sys.exit(code)
