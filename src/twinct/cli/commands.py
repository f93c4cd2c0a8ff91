"""All commands, in the order of the help; their arguments are in the files of this package."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Sequence

import tyro

from twinct.cli.arm import arm
from twinct.cli.calibrate import METHODS, Errors, calibrate
from twinct.cli.ctsimu import ctsimu
from twinct.cli.demo import demo
from twinct.cli.drive import drive
from twinct.cli.finished import (
    compare,
    export,
    geometry,
    import_,
    reconstruct,
    report,
    verify,
)
from twinct.cli.optional import mark_optional
from twinct.cli.planning import motion, place, plan, reach, uncertainty
from twinct.cli.predict import predict
from twinct.cli.running import node, run, view
from twinct.cli.scenarios import check, init, render, schema, specimen, urdf
from twinct.cli.study import study
from twinct.core.errors import InputError
from twinct.core.foreign_text import quoted
from twinct.link.recording.arms_recording import ArmsRecording

CALIBRATE = "Estimate the executed poses of source and detector, and add them as a geometry."
CTSIMU = "Scenarios in the CTSimU format: render, export, qualify."

_FUNCTIONS: tuple[Callable[..., None], ...] = (
    *(demo, init, check, run, view, render, reach, plan, uncertainty, place, node, urdf, schema),
    *(motion, drive, arm, specimen, export, import_, report, compare, verify, reconstruct, predict),
    *(geometry, study),
)
_GROUPS = {"calibrate": (calibrate, CALIBRATE), "ctsimu": (ctsimu, CTSIMU)}
_METHODS = {"calibrate": tuple(METHODS), "ctsimu": ("render", "export", "qualify")}
NAMES = (*(function.__name__.rstrip("_") for function in _FUNCTIONS), *_GROUPS)


def _application(*, summaries: bool) -> tyro.extras.SubcommandApp:
    """Return all commands; with ``summaries``, each has the first sentence of its help alone."""
    made = tyro.extras.SubcommandApp()
    for name, function in zip(NAMES, _FUNCTIONS, strict=False):
        summary = " ".join((function.__doc__ or "").partition("\n\n")[0].split())
        made.command(name=name, help=summary if summaries else None)(mark_optional(function))
    for name, (group, summary) in _GROUPS.items():
        made.command(group, name=name, help=summary)
    return made


mark_optional(ArmsRecording, "arms.")
mark_optional(Errors)
app = _application(summaries=False)


def overview() -> tyro.extras.SubcommandApp:
    """Return the commands for the help of twinct itself, which fits on a screen."""
    return _application(summaries=True)


def check_names(arguments: Sequence[str]) -> None:
    """Check the name of a command, and of its method if it has several.

    Raises:
        InputError: there is no such command; the message has the nearest name, and all names.
    """
    for depth, known in enumerate((NAMES, _METHODS.get((*arguments, "")[0], ()))):
        word = next(iter(arguments[depth : depth + 1]), "-")
        if not known or word in known or word.startswith("-"):
            continue
        near = difflib.get_close_matches(word, known, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        what = " ".join(["twinct", *arguments[:depth]])
        raise InputError(f"{what} has no command {quoted(word)}{hint} ({', '.join(known)})")
