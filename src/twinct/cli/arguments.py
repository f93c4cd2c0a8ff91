"""Arguments that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

ScenarioFile = Annotated[
    tyro.conf.Positional[Path],
    tyro.conf.arg(
        metavar="SCENARIO",
        help="Scenario file (YAML), or the name of a built-in scenario, such as demo.",
    ),
]
Overrides = Annotated[
    tyro.conf.UseAppendAction[tuple[str, ...]],
    tyro.conf.arg(
        name="set",
        metavar="KEY=VALUE",
        help="Override a key of the scenario, such as --set detector.columns=320; may be given "
        "several times.",
    ),
]
Threads = Annotated[
    int | None,
    tyro.conf.arg(
        metavar="N",
        help="Threads per process.",
        help_behavior_hint="(default: TWINCT_THREADS, or all available)",
    ),
]
Flag = tyro.conf.FlagCreatePairsOff[bool]
Json = Annotated[
    Flag,
    tyro.conf.arg(
        name="json",
        help="Print one JSON object for scripts; everything else goes to stderr.",
    ),
]

LOOPBACK, PAGE_PORT = "127.0.0.1", 8080
Host = Annotated[str, tyro.conf.arg(help="Address that the page listens on.")]
Port = Annotated[int, tyro.conf.arg(help="Port of the page; 0: any free port.")]
Network = Annotated[
    Flag,
    tyro.conf.arg(
        help="Let other machines open the page (--host) if they know its address. "
        "Nothing is encrypted."
    ),
]
