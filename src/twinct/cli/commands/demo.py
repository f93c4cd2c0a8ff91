"""The command ``twinct demo``: the small example, with what is installed and works here."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import tyro

from twinct import runs
from twinct.cli.arguments import Overrides, Threads
from twinct.cli.parts import try_gvxr
from twinct.cli.progress import on_terminal, say
from twinct.cli.summary import say_result
from twinct.core.errors import InputError, MissingExtraError
from twinct.core.extras import WAY_OUT, require
from twinct.core.threads import limit_threads
from twinct.link import require_ros
from twinct.scenario import load_scenario, named_places

NAME = "demo"


def demo(
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("twinct-demo"),
    threads: Threads = None,
    set_: Overrides = (),
) -> None:
    """Run the built-in scenario demo with what is installed.

    If a part is not installed or does not work, the demo uses a substitute and says which and why.
    Takes one to three minutes; the last line is the path of the report. Repeat the command to
    continue an interrupted demo.

    Args:
        out: Folder for the results.
    """
    limit_threads(threads)
    load_scenario(NAME, set_)  # a mistake in it is told before anything is tried
    chosen = (*_arms(), *_engine(set_), *set_)  # what the user sets comes last, and counts
    link = _link()
    loaded = load_scenario(NAME, chosen)
    with named_places(NAME, chosen), on_terminal() as audience:
        finished = runs.run(
            loaded,
            out,
            link=link,
            resume=out.exists(),
            threads=threads,
            observers=audience,
        )
    say_result(finished)


def _arms() -> Sequence[str]:
    """Return the override that replaces arms whose libraries are missing; none if they work."""
    try:
        require("robots")
    except InputError as error:
        say(f"cell: a gantry instead of two arms, because {_why(error)}")
        return ("cell.kind=gantry",)
    say("cell: two arms (MuJoCo)")
    return ()


def _engine(set_: Overrides) -> Sequence[str]:
    """Return the override that replaces gVXR where it is missing or cannot draw."""
    if any(override.strip().startswith("xray") for override in set_):
        return ()
    try:
        try_gvxr()
    except InputError as error:
        say(f"X-ray engine: mesh instead of gvxr, because {_why(error)}")
        return ("xray.engine=mesh",)
    say("X-ray engine: gvxr")
    return ()


def _link() -> Literal["ros2", "local"]:
    """Return the link that works here."""
    try:
        require_ros()
    except InputError as error:
        say(f"link: local instead of ros2, because {_why(error)}")
        return "local"
    say("link: ros2")
    return "ros2"


def _why(error: InputError) -> str:
    """Return the reason alone, without the ways out that the demo takes itself."""
    reason = error.problems[0]
    for way_out in WAY_OUT.values():
        reason = reason.removesuffix(f", {way_out}")
    if isinstance(error, MissingExtraError):
        return f"twinct[{','.join(error.extras)}] is not installed"
    return reason
