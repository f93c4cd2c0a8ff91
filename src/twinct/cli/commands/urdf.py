"""``twinct urdf``: a robot description of the room."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from twinct.cli.arguments import Flag, Overrides, ScenarioFile
from twinct.cli.scenario_at import scenario_at
from twinct.runs.scenario_files import write_urdf


def urdf(
    scenario: ScenarioFile,
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    moveit: Flag = False,
    set_: Overrides = (),
) -> None:
    """Write a robot description of the operating room, for ROS 2 and other readers of URDF.

    Args:
        out: Folder for cell.urdf and its meshes.
        moveit: Write the arms (arms.urdf, arms.srdf, joint_limits.yaml) and the room with its
            forbidden zones (room.scene) for MoveIt instead. We have not tried them in MoveIt yet.
    """
    with scenario_at(scenario, set_) as loaded:
        files = write_urdf(loaded, out, moveit=moveit)
    Console().print(f"wrote {', '.join(map(str, files))}", highlight=False)
