"""All commands, in groups and in the order of the help, each a module loaded when it is chosen."""

from __future__ import annotations

import difflib
import keyword
import textwrap
from collections.abc import Callable, Sequence
from functools import cache
from importlib import import_module
from typing import Any

import tyro

from twinct.cli.optional import mark_optional
from twinct.core.errors import InputError
from twinct.core.foreign_text import quoted

GROUPS = {
    "start": {
        "demo": "Run the built-in scenario demo with what is installed.",
        "init": "Write a scenario to start from, with a comment on each key.",
        "doctor": "Say what works on this machine, and what to type for the rest.",
        "check": "Validate a scenario, build its specimen, plan its motion and rehearse it, "
        "without running it.",
        "run": "Run a scenario: plan, move, expose, reconstruct, evaluate, report.",
        "view": "Show a run in a browser: room, beam, images, volume, errors; also while it runs.",
    },
    "look at a scene": {
        "design": "Design a scenario in a browser: bodies, path, image, reach, time.",
        "render": "Draw the operating room at one view.",
        "reach": "Show which directions source and panel can reach, all over the sphere, at one or "
        "more radii.",
        "specimen": "Build the specimen only: a mesh for each part, the voxel truth and a picture.",
        "dose": "Compute the dose of a scenario's views to its parts and labels.",
        "uncertainty": "Compute the effects of a scenario's errors, without rendering.",
    },
    "plan": {
        "plan": "Choose views for the section task of a scenario, among the views that the arms "
        "can reach.",
        "place": "Find good positions of the arms for a scenario's trajectory, or for most of the "
        "sphere.",
        "motion": "Plan the motion of a scenario, and write it for the controllers of real arms.",
    },
    "calibrate and correct": {
        "calibrate": "Estimate the executed poses of source and detector, and add them as a "
        "geometry.",
        "geometry": "List the geometries of a scan, or derive a new one: poses that its robots "
        "would report.",
        "predict": "Render a scan again and compare it with its images, view by view.",
    },
    "reconstruct and judge": {
        "reconstruct": "Reconstruct a finished run again, beside its volume, and show both in its "
        "report.",
        "report": "Evaluate a finished run again and rewrite its metrics.json and report.html.",
        "compare": "Compare finished runs on one page: slices, figures, pose errors, times, and "
        "their scenarios.",
        "verify": "Compare each file of a scan with its stored digest, and check its results.",
    },
    "exchange": {
        "import": "Import a measured scan, or a scan's recordings: DIR/scan.zarr and "
        "DIR/scenario.yaml.",
        "export": "Write a scan in a form that another toolkit can reconstruct directly, or one of "
        "its volumes.",
        "ctsimu": "Scenarios in the CTSimU format: render, export, qualify.",
        "schema": "Print the JSON Schema of the scenario file, for editors.",
    },
    "robots and ROS 2": {
        "node": "Start one simulation as a separate ROS 2 node, until it is interrupted.",
        "drive": "Send the plan of a scenario to controllers of arms, and record the messages of "
        "their drivers.",
        "arm": "Write the URDF of a vendor's arm into a folder of its own, with all meshes.",
        "urdf": "Write a robot description of the operating room, for ROS 2 and other readers of "
        "URDF.",
    },
    "many scans": {
        "study": "Run a study: many trials of one scenario, which share their common steps.",
    },
}
"""First sentences of the commands' help, by purpose; newcomers need the first group."""

COMMANDS = {name: said for group in GROUPS.values() for name, said in group.items()}

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


def application() -> tyro.extras.SubcommandApp:
    """Return all commands, for what shells need to complete them."""
    made = tyro.extras.SubcommandApp()
    for name, summary in COMMANDS.items():
        if isinstance(command := command_named(name), tyro.extras.SubcommandApp):
            made.command(command, name=name, help=summary)
        else:
            made.command(name=name)(command)
    return made


def overview(width: int) -> str:
    """Return the help of twinct itself: all commands in groups, in lines of this width."""
    column = max(map(len, COMMANDS)) + 4

    def line(name: str, summary: str) -> str:
        first = f"  {name}".ljust(column)
        return textwrap.fill(summary, width, initial_indent=first, subsequent_indent=column * " ")

    about = (
        "Simulates a twin robotic CT system from one scenario file: two arms, X-ray projections, "
        "ROS 2, reconstruction and evaluation."
    )
    more = (
        "twinct COMMAND --help explains a command, --version prints the version, and --completion "
        "bash|zsh|fish prints what a shell needs to complete commands."
    )
    parts = ["usage: twinct COMMAND ...", textwrap.fill(about, width)]
    for group, commands in GROUPS.items():
        lines = [line(name, summary) for name, summary in commands.items()]
        parts.append("\n".join([f"{group}:", *lines]))
    return "\n\n".join([*parts, textwrap.fill(more, width)]) + "\n"


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
