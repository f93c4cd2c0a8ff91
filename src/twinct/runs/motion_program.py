"""A scenario's motion for the controllers of real arms: as a program, and as files."""

from __future__ import annotations

from pathlib import Path

from twinct.core.arguments import kinds_checked
from twinct.core.errors import InputError
from twinct.core.extras import require
from twinct.core.progress import SILENT, Progress
from twinct.observers import Observers, audience_of
from twinct.robots.motion import Gate, gate_of
from twinct.robots.programs import (
    Program,
    check_absent,
    language_named,
    program_of,
    write_program,
)
from twinct.scan import SimulationBuilder
from twinct.scenario import Scenario, as_scenario


def motion_program(
    scenario: Scenario, prefixes: tuple[str, str] = ("", ""), progress: Progress = SILENT
) -> tuple[Program, Gate]:
    """Return a scenario's plan under the names of the drivers, and the gate of its joints.

    Args:
        scenario: the scenario.
        prefixes: prefix of the joints of the source arm and of the detector arm.
        progress: progress display.

    Raises:
        InputError: the scenario has no arms, or no plan.
        TrajectoryError: a view is out of reach or would collide.
    """
    if scenario.cell.kind != "arms":
        raise InputError(f"cell.kind: a {scenario.cell.kind} has no arms to move")
    if scenario.motion.scheme == "reactive":
        raise InputError("motion.scheme: reactive has no plan to write; set it to planned")
    require("robots")
    builder = SimulationBuilder(scenario)
    with progress.stage("planning the motion", 1) as step:
        plan = builder.followed
        step()
    assert plan is not None
    program = program_of(plan, f"{scenario.name}, plan {plan.digest[:12]}", prefixes)
    return program, gate_of(builder.cell, scenario.motion)


@kinds_checked
def write_motion(
    scenario: Scenario | str | Path,
    to: str,
    out: str | Path,
    *,
    prefixes: tuple[str, str] = ("", ""),
    observers: Observers = (),
) -> Program:
    """Plan the motion of a scenario, and write it for the controllers of real arms.

    The folder also gets triggers.csv, with the time and the commanded poses of each view.

    Args:
        scenario: the scenario, or its file.
        to: name of a format; ``twinct.robots.programs.languages`` returns all of them.
        out: folder to write, which must not exist.
        prefixes: prefix of the joints of the source arm and of the detector arm.
        observers: notified of the progress.

    Raises:
        InputError: an unknown format, no arms, or no plan.
        MissingExtraError: the extra ``robots`` is not installed.
        ScanExistsError: the folder exists.
        TrajectoryError: a view is out of reach or would collide.
    """
    require("robots")
    language, out = language_named(to), Path(out)
    check_absent(out)
    with audience_of(observers) as audience:
        program, _ = motion_program(as_scenario(scenario), prefixes, audience)
    write_program(out, language.write(program))
    return program
