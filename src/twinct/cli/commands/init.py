"""``twinct init``: a scenario to start from."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from twinct.cli.progress import say
from twinct.core.errors import InputError
from twinct.core.files.writing import storage_errors, write_text
from twinct.scenario.commented import commented_scenario


def init(
    file: Annotated[
        tyro.conf.Positional[Path], tyro.conf.arg(metavar="FILE", help="Scenario file to write.")
    ] = Path("scenario.yaml"),
    *,
    from_: Annotated[str, tyro.conf.arg(name="from", metavar="NAME")] = "demo",
) -> None:
    """Write a scenario to start from, with a comment on each key.

    Args:
        from_: Built-in scenario to copy, such as circle_gantry, head or patient_spine.
    """
    if file.suffix not in (".yaml", ".yml"):
        raise InputError(f"{file}: a scenario file must end in .yaml")
    if file.exists():
        raise InputError(f"{file} exists already; choose another name, or remove it")
    text = commented_scenario(from_, str(file))
    with storage_errors(file):
        file.parent.mkdir(parents=True, exist_ok=True)
        write_text(file, text)
    say(f"wrote {file}; 'twinct check {file}' says whether it can be run")
