"""All commands, in the order of the help. A command is one module, loaded when it is chosen."""

from __future__ import annotations

import difflib
import keyword
from collections.abc import Callable, Sequence
from functools import cache
from importlib import import_module
from typing import Any

import tyro

from twinct.cli.optional import mark_optional
from twinct.core.errors import InputError
from twinct.core.foreign_text import quoted

COMMANDS = {
    "demo": "Run the built-in scenario demo with the engines and the link that are installed.",
    "init": "Write a scenario to start from, with a comment on each key.",
    "check": "Validate a scenario, build its specimen, plan its motion and rehearse it, without "
    "running it.",
    "run": "Run a scenario: plan, move, expose, reconstruct, evaluate, report.",
    "view": "Show a run in a browser: room, beam, images, volume, errors; also while it runs.",
    "render": "Draw the operating room at one view.",
    "reach": "Show which directions source and panel can reach, all over the sphere, at one or "
    "more radii.",
    "plan": "Choose views for the section task of a scenario, among the views that the arms can "
    "reach.",
    "uncertainty": "Compute the effects of a scenario's errors on poses and images, by cause, "
    "without rendering.",
    "place": "Find good positions of the arms for a scenario's trajectory, or for most of the "
    "sphere.",
    "node": "Start one simulation as a separate ROS 2 node, until it is interrupted.",
    "urdf": "Write a robot description of the operating room, for ROS 2 and other readers of URDF.",
    "schema": "Print the JSON Schema of the scenario file, for editors.",
    "motion": "Plan the motion of a scenario, and write it for the controllers of real arms.",
    "drive": "Send the plan of a scenario to controllers of arms, and record the messages of their "
    "drivers.",
    "arm": "Write the URDF of a vendor's arm into a folder of its own, with all meshes.",
    "specimen": "Build the specimen only: a mesh for each part, the voxel truth and a picture.",
    "export": "Write a scan in a form that another toolkit can reconstruct directly, or one of its "
    "volumes.",
    "import": "Import a measured scan, or a scan's recordings: DIR/scan.zarr and "
    "DIR/scenario.yaml.",
    "report": "Evaluate a finished run again and rewrite its metrics.json and report.html.",
    "compare": "Compare finished runs on one page: slices, figures, pose errors, times, and their "
    "scenarios.",
    "verify": "Compare each file of a scan with its stored digest, and check its results.",
    "reconstruct": "Reconstruct a finished run again, beside its volume, and show both in its "
    "report.",
    "predict": "Render a scan again and compare the result with its images, view by view.",
    "geometry": "List the geometries of a scan, or derive a new one: poses that its robots would "
    "report.",
    "study": "Run a study: many trials of one scenario, which share their common steps.",
    "calibrate": "Estimate the executed poses of source and detector, and add them as a geometry.",
    "ctsimu": "Scenarios in the CTSimU format: render, export, qualify.",
}
"""First sentences of the commands' help."""

METHODS = {
    "calibrate": ("beads", "balls", "self", "circle", "kinematics"),
    "ctsimu": ("render", "export", "qualify"),
}
"""Commands that are groups, with their methods."""


@cache
def command_named(name: str) -> Callable[..., None] | tyro.extras.SubcommandApp:
    """Return a command as tyro takes it; a group is an application of its own."""
    word = f"{name}_" if keyword.iskeyword(name) else name
    command: Any = getattr(import_module(f"{__name__}.{word}"), word)
    return command if name in METHODS else mark_optional(command)


def execute(arguments: Sequence[str]) -> None:
    """Execute a command.

    Args:
        arguments: its name, checked by ``check_names``, and its arguments.
    """
    name, *rest = arguments
    prog, command = f"twinct {name}", command_named(name)
    if isinstance(command, tyro.extras.SubcommandApp):
        command.cli(prog=prog, description=COMMANDS[name], args=rest)
    else:
        tyro.cli(command, prog=prog, args=rest)


def application(*, overview: bool = False) -> tyro.extras.SubcommandApp:
    """Return all commands, for what shells need to complete them.

    Args:
        overview: load no command; enough for the help of twinct itself.
    """
    made = tyro.extras.SubcommandApp()
    for name, summary in COMMANDS.items():
        if overview:
            made.command(name=name, help=summary)(_nothing)
        elif isinstance(command := command_named(name), tyro.extras.SubcommandApp):
            made.command(command, name=name, help=summary)
        else:
            made.command(name=name)(command)
    return made


def _nothing() -> None:
    """Do nothing."""


def check_names(arguments: Sequence[str]) -> None:
    """Check the name of a command, and of its method if it has several.

    Raises:
        InputError: there is no such command; the message has the nearest name, and all names.
    """
    for depth, known in enumerate((tuple(COMMANDS), METHODS.get((*arguments, "")[0], ()))):
        word = next(iter(arguments[depth : depth + 1]), "-")
        if not known or word in known or (word.startswith("-") and depth):
            continue
        near = difflib.get_close_matches(word, known, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        what = " ".join(["twinct", *arguments[:depth]])
        raise InputError(f"{what} has no command {quoted(word)}{hint} ({', '.join(known)})")
