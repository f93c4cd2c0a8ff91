"""Commands that search for positions, views, errors and motions before a run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from twinct.cli.arguments import Flag, Json, Overrides, ScenarioFile, Threads
from twinct.cli.json_answer import answering
from twinct.core.extras import require
from twinct.core.foreign_text import counted


def reach(
    scenario: ScenarioFile,
    *,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    radii: Annotated[tuple[float, ...], tyro.conf.arg(metavar="MM")] = (),
    odd: Annotated[float | None, tyro.conf.arg(metavar="MM")] = None,
    directions: int = 1000,
    connected: Flag = False,
    as_json: Json = False,
    set_: Overrides = (),
) -> None:
    """Show which directions source and panel can reach, all over the sphere, at one or more radii.

    Source and panel may be turned about the beam.

    Args:
        out: Folder for reach.json, reach.csv, and pictures of the sphere and of the room.
        radii: Distances from the isocentre to the source (default: the scenario's).
        odd: Distance from the isocentre to the panel (default: the scenario's).
        directions: Number of directions.
        connected: Also search for collision-free paths between directions, which takes minutes.
    """
    from twinct.cli.reach import reach_command

    with answering(as_json) as answer:
        shares = reach_command(scenario, set_, out, radii, odd, directions, connected)
        answer |= {"directions": directions, "shares": shares}


def place(
    scenario: ScenarioFile,
    *,
    sphere: Flag = False,
    save: Annotated[Path | None, tyro.conf.arg(metavar="YAML")] = None,
    x: tuple[float, float] = (-1000.0, 1000.0),
    y: tuple[float, float] = (-1000.0, 1000.0),
    z: tuple[float, float] = (-800.0, 400.0),
    standoff: tuple[float, float] = (100.0, 300.0),
    tool_rotation: tuple[float, float] = (-180.0, 180.0),
    samples: int = 128,
    seed: int = 0,
    as_json: Json = False,
    set_: Overrides = (),
) -> None:
    """Find good positions of the arms for a scenario's trajectory, or for most of the sphere.

    Args:
        sphere: Reach as many directions as possible; source and panel may turn about the beam.
        save: Write a scenario with the resulting keys.
        x: Lowest and highest position of a base, mm.
        y: Lowest and highest position of a base, mm.
        z: Lowest and highest position of a base, mm.
        standoff: Distance from flange to focal spot and panel centre, mm.
        tool_rotation: Turn of the tools about the flange axis, deg.
        samples: Positions of each single arm that are tried first.
        seed: Seed of the search.
    """
    from twinct.cli.reach import place_command
    from twinct.robots.reach import Bounds

    bounds = Bounds(x, y, z, standoff, tool_rotation)
    with answering(as_json) as answer:
        answer |= place_command(scenario, set_, sphere, save, bounds, samples, seed)


def plan(
    scenario: ScenarioFile,
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    scout: Annotated[Path | None, tyro.conf.arg(metavar="RUN")] = None,
    try_views: Annotated[Flag, tyro.conf.arg(name="try")] = False,
    address: Annotated[str | None, tyro.conf.arg(metavar="auto|local|HOST:PORT")] = None,
    jobs: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    resume: Flag = False,
    threads: Threads = None,
    set_: Overrides = (),
) -> None:
    """Choose views for the section task of a scenario, among the views that the arms can reach.

    Writes views.csv, planned.yaml (which twinct run executes), plan.npz, plan.json and plan.png.

    Args:
        out: Folder for the results.
        scout: Run of a few views, used to locate the specimen before planning.
        try_views: Simulate images of the planned views and of the scenario's path, and compare
            the volumes in tried.png.
        address: Address of Ray; local starts Ray on this machine. Default: local processes.
        jobs: Processes that search for reachable views and evaluate paths of a family (default: as
            many as there are threads).
        resume: Resume an interrupted search.
    """
    from twinct.cli.plan import plan_command

    plan_command(scenario, set_, out, scout, try_views, address, jobs, resume, threads)


def uncertainty(
    scenario: ScenarioFile,
    *,
    draws: int = 1000,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    picture: Annotated[Path, tyro.conf.arg(metavar="PNG")] = Path("view.png"),
    as_json: Json = False,
    set_: Overrides = (),
) -> None:
    """Compute the effects of a scenario's errors on poses and images, by cause, without rendering.

    Args:
        draws: Number of scans to draw.
        out: Folder for uncertainty.json, with all covariances, and uncertainty.png.
        picture: File for the picture of an infeasible view.
    """
    from twinct.cli.uncertainty import uncertainty_command

    with answering(as_json) as answer:
        answer |= uncertainty_command(scenario, set_, draws, out, picture)


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
    from twinct.cli.drive import planned
    from twinct.cli.progress import say

    require("robots")
    from twinct.robots.programs import check_absent, language_named, write_program

    language = language_named(to)
    check_absent(out)
    _, program, _ = planned(scenario, set_, (source_prefix, detector_prefix))
    write_program(out, language.write(program))
    plan = program.plan
    say(f"wrote {out}: {counted(len(plan.targets), 'view')} in {plan.duration_s:.1f} s")
