"""The command that sends a plan to the controllers of real arms."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Annotated, Any

import tyro

from twinct.cli.arguments import Overrides, ScenarioFile
from twinct.cli.progress import on_terminal, say
from twinct.cli.scenario_at import scenario_at
from twinct.core.errors import InputError, ScanExistsError
from twinct.core.extras import require
from twinct.core.files.writing import storage_errors
from twinct.link import require_ros
from twinct.link.arm_types import follow_joint_trajectory
from twinct.link.environment import ROS_ARGUMENTS
from twinct.runs.motion_program import motion_program

Names = Annotated[tuple[str, ...], tyro.conf.arg(metavar="TOPIC")]


def drive(
    scenario: ScenarioFile,
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="FILE.mcap")],
    source: Annotated[str | None, tyro.conf.arg(metavar="ACTION")] = None,
    detector: Annotated[str | None, tyro.conf.arg(metavar="ACTION")] = None,
    both: Annotated[str | None, tyro.conf.arg(metavar="ACTION")] = None,
    source_prefix: str = "",
    detector_prefix: str = "",
    speed: float = 1.0,
    start_tolerance_deg: float = 0.5,
    patience_s: float = 10.0,
    joint_states: Names = ("/joint_states",),
    descriptions: Names = ("/robot_description",),
    record: Names = (),
    set_: Overrides = (),
) -> None:
    """Send the plan of a scenario to controllers of arms, and record the messages of their drivers.

    The controllers are servers of control_msgs/action/FollowJointTrajectory, in the domain
    ROS_DOMAIN_ID. The arms must already stand at the start of the plan. This command has not moved
    a real arm yet: try it in the controller's own simulation first. Ctrl-C tells all controllers to
    stop.

    Args:
        out: Recording to write, which must not exist; twinct import reads it.
        source: Controller of the source arm, such as /left/arm_controller/follow_joint_trajectory.
        detector: Controller of the detector arm; both start together.
        both: Controller of both arms, instead of two.
        source_prefix: Prefix of the joint names of the source arm's driver.
        detector_prefix: Prefix of the joint names of the detector arm's driver.
        speed: Share of the plan's speed, above 0 and at most 1.
        start_tolerance_deg: Largest distance of a joint from the start of the plan.
        patience_s: Time without an answer after which a controller counts as silent.
        joint_states: Topics of the drivers' joint states.
        descriptions: Topics of the drivers' descriptions, whose limits the plan must keep.
        record: Further topics to record, such as those of the detector.
    """
    actions = _actions(source, detector, both, speed)
    prefixes = source_prefix, detector_prefix
    topics = joint_states, descriptions, record
    _drive(
        scenario, set_, prefixes, out, actions, speed, (*topics, start_tolerance_deg, patience_s)
    )


def _actions(
    source: str | None, detector: str | None, both: str | None, speed: float
) -> tuple[str, ...]:
    """Return the controllers: one of both arms, or one of each.

    Raises:
        InputError: others are named, or the speed is out of range.
    """
    if not 0 < speed <= 1:
        raise InputError(f"--speed {speed:g}: must be above 0 and at most 1")
    if both and not source and not detector:
        return (both,)
    if both or not source or not detector:
        raise InputError("name the controllers: either --source and --detector, or --both")
    return source, detector


def _drive(
    scenario: Path,
    set_: Sequence[str],
    prefixes: tuple[str, str],
    out: Path,
    actions: tuple[str, ...],
    speed: float,
    choices: tuple[Any, ...],
) -> None:
    """Plan, send, and say what was recorded; ``choices`` are the fields of ``DriveSettings``."""
    if out.suffix.lower() != ".mcap":
        raise InputError(f"--out {out}: a recording is an MCAP file; its name must end in .mcap")
    if out.exists():
        raise ScanExistsError(f"{out} exists already: choose another --out")
    require("robots", "record")
    require_ros()
    from twinct.link.driving import Drive, DriveSettings, names_of
    from twinct.link.follow import courses
    from twinct.link.participant import Station
    from twinct.link.recording.drive_file import DriveFile

    follow_joint_trajectory()  # before a plan takes its time
    with scenario_at(scenario, set_) as loaded, on_terminal() as audience:
        program, gate = motion_program(loaded, prefixes, audience)
    parts = courses(program, actions, speed)
    names = names_of(parts, program.plan.joint_names)
    run: Drive | None = None
    with (
        storage_errors(out, "the drive has ended"),
        closing(DriveFile(out, loaded, program.plan, names, choices[0])) as file,
    ):
        try:
            with closing(Station("twinct_drive", ros_arguments=ROS_ARGUMENTS)) as station:
                domain = station.domain_id
                say(f"{parts[0].duration_s:.1f} s of motion; controllers of ROS domain {domain}")
                run = Drive(station, parts, DriveSettings(*choices), file, gate)
                run.run()
        except BaseException:
            if run is None or not run.sent:  # nothing moved, so the recording tells nothing
                out.unlink(missing_ok=True)
            else:
                say(f"{out} holds the messages until then", warning=True)
            raise
        finally:
            for sentence in () if run is None else run.notes:
                say(sentence, warning=True)
    heard = ", ".join(f"{count} of {topic}" for topic, count in file.heard.items())
    say(f"the controllers followed the plan; wrote {out} with {heard}")
