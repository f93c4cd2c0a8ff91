"""``twinct verify``: the files of a scan against their digests."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import tyro

from twinct import runs
from twinct.cli.arguments import Json
from twinct.cli.json_answer import answering
from twinct.cli.progress import say
from twinct.core.foreign_text import counted


def verify(
    folder: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")],
    *,
    as_json: Json = False,
) -> None:
    """Compare each file of a scan with its stored digest, and check its results.

    Exits with 1 if anything is damaged, missing or unfinished; 'twinct run --resume' acquires
    damaged parts of a scan again.

    Args:
        folder: Folder of twinct run --out, or its scan.zarr.
    """
    with answering(as_json) as answer:
        damages = runs.verify(folder)
        for problem in damages.problems:
            say(problem, warning=True)
        for file in damages.unknown:
            say(f"{file}: unknown file, ignored")
        state = counted(len(damages.problems), "problem") if damages.problems else "intact"
        say(f"{folder}: {state} ({damages.in_words})")
        answer |= {"intact": not damages.problems, "problems": damages.problems}
        answer["unknown"] = [str(file) for file in damages.unknown]
    if damages.problems:
        sys.exit(1)
