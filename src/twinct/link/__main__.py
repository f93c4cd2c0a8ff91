"""``python -m twinct.link {robots,xray} SCENARIO``: the command by which the rig starts a node."""

from __future__ import annotations

import argparse
import faulthandler
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twinct.core.errors import TwinctError
from twinct.core.threads import limit_threads
from twinct.link import require_ros
from twinct.scenario import load_scenario

if TYPE_CHECKING:
    from twinct.geometry import Panel
    from twinct.link.robots_node import Robots
    from twinct.link.xray_node import XRay


def main(
    arguments: Sequence[str] | None = None,
    *,
    build_robots: Callable[[], Robots] | None = None,
    build_imager: Callable[[Panel], XRay] | None = None,
) -> int:
    """Run one node of a scan, with the real or a given simulation, until its rig is done."""
    parser = argparse.ArgumentParser(prog="python -m twinct.link", description=__doc__)
    parser.add_argument("node", choices=["robots", "xray"])
    parser.add_argument("scenario", type=Path)
    parser.add_argument("--epoch")
    parser.add_argument("--members", type=Path, help="folder where the scan's processes register")
    parser.add_argument("--first-view", type=int, default=0)
    parser.add_argument(
        "--planned", action="store_true", help="follow the plan that the scan publishes"
    )
    parser.add_argument("--restore", type=Path)
    parser.add_argument("--specimen", type=Path, help="file of the built specimen")
    parser.add_argument("--lifeline", action="store_true", help="end when stdin ends")
    given = parser.parse_args(arguments)
    try:
        limit_threads()
        require_ros()
        from twinct.link.senders import Members

        scenario = load_scenario(given.scenario)
        common: dict[str, Any] = {"epoch": given.epoch, "lifeline": given.lifeline}
        common["specimen"] = given.specimen
        common["members"] = Members(given.members) if given.members else None
        if given.node == "xray":
            from twinct.link.xray_node import spin_xray

            return spin_xray(scenario, build=build_imager, **common)
        from twinct.link.robots_node import spin_robots

        return spin_robots(
            scenario,
            first_view=given.first_view,
            planned=given.planned,
            restore=given.restore,
            build=build_robots,
            **common,
        )
    except TwinctError as error:
        sys.stderr.write(f"twinct: {error}\n")
        return error.exit_code


if __name__ == "__main__":
    if sys.stderr is not None:
        faulthandler.enable()  # a crash in a library leaves its stack in the log
    sys.exit(main())
