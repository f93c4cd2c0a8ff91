"""``twinct motion``: a plan as files for the controllers of real arms."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from twinct.cli.arguments import Overrides, ScenarioFile
from twinct.cli.progress import on_terminal, say
from twinct.cli.scenario_at import scenario_at
from twinct.core.foreign_text import counted
from twinct.runs.motion_program import write_motion


def motion(
    scenario: ScenarioFile,
    *,
    to: Annotated[str, tyro.conf.arg(metavar="FORMAT")],
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    source_prefix: str = "",
    detector_prefix: str = "",
    set_: Overrides = (),
) -> None:
    """Plan the motion of a scenario, and write it for the controllers of real arms.

    DIR also gets triggers.csv, with the time and the commanded poses of each view. No such file has
    been run on hardware yet.

    Args:
        to: joint-trajectory (ROS 2), csv or urscript, or one of another package.
        out: Folder to write, which must not exist.
        source_prefix: Prefix of the joint names of the source arm's driver.
        detector_prefix: Prefix of the joint names of the detector arm's driver.
    """
    prefixes = source_prefix, detector_prefix
    with scenario_at(scenario, set_) as loaded, on_terminal() as audience:
        plan = write_motion(loaded, to, out, prefixes=prefixes, observers=audience).plan
    say(f"wrote {out}: {counted(len(plan.targets), 'view')} in {plan.duration_s:.1f} s")
