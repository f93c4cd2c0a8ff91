"""``twinct doctor``: what works on this machine, and what to type for the rest."""

from __future__ import annotations

from typing import Any

from rich.console import Console

from twinct.cli.arguments import Json
from twinct.cli.json_answer import answering
from twinct.cli.parts import PARTS, Part
from twinct.core.errors import InputError


def doctor(*, as_json: Json = False) -> None:
    """Say what works on this machine, and what to type for the rest.

    Tries arms, engines, links, pictures and all other extras, in a few seconds. Nothing is
    installed or changed.
    """
    with answering(as_json) as answer:
        answer["parts"] = [_found(part) for part in PARTS]
        column = max(len(part.name) for part in PARTS) + 2
        for one in answer["parts"]:
            problems = "; ".join(one["problems"])
            words = f"does not work: {problems}" if problems else f"works: {one['purpose']}"
            # Commands stay on one line, so that they can be copied.
            Console().print(
                f"{one['part']:{column}}{words}", soft_wrap=True, highlight=False, markup=False
            )


def _found(part: Part) -> dict[str, Any]:
    problems: tuple[str, ...] = ()
    try:
        part.attempt()
    except InputError as error:
        problems = error.problems
    facts = {"part": part.name, "purpose": part.purpose}
    return facts | {"works": not problems, "problems": problems}
