"""``twinct design``: the page that changes a scenario."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from twinct.cli.arguments import LOOPBACK, PAGE_PORT, Host, Network, Port
from twinct.core.extras import require


def design(
    scenario: Annotated[
        tyro.conf.Positional[Path],
        tyro.conf.arg(
            metavar="SCENARIO",
            help="Scenario file, which may be new; or the name of a built-in scenario, which "
            "design.yaml then extends.",
        ),
    ] = Path("demo"),
    *,
    host: Host = LOOPBACK,
    port: Port = PAGE_PORT,
    allow_network: Network = False,
) -> None:
    """Design a scenario in a browser: bodies, path, image, reach, time.

    Each change is one edit of the file, which is written when you save it. Until then the draft is
    kept beside the file.
    """
    require("view", "robots", "xray")
    from twinct.cli.live_page import design_scenario  # viser is optional, and slow

    design_scenario(scenario, host, port, allow_network)
