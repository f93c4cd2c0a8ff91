"""A scenario as a text to edit: each key that is set, with its description as a comment."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from twinct.core.files.plain_yaml import written_on_a_line
from twinct.scenario.loading import load_scenario
from twinct.scenario.objects import with_paths
from twinct.scenario.reading import drafted, is_list, is_mapping
from twinct.scenario.starting import Start

WIDTH = 100
_HEAD = """\
# A scenario of twinct, made by 'twinct init' from the built-in scenario {name}{own}.
#   {check}  can it be run?
#   {run}  images, volume, report
# Keys that are left out have defaults: 'twinct schema' lists all keys. Lengths are in mm.
"""


def commented_scenario(start: Start, file: Path) -> str:
    """Return a scenario to start from as YAML, each key with its description as a comment.

    What the scenario extends is part of the text, so that it stands alone. Files in the folder of
    the text are named relative to it.

    Args:
        start: the built-in scenario and what differs from it.
        file: file that the text is for.

    Raises:
        ScenarioError: there is no such scenario, or what differs is wrong.
    """
    folder = file.absolute().parent

    def named(path: Path) -> Path:
        return path.relative_to(folder) if path.is_relative_to(folder) else path

    model = load_scenario(start.name, start.changes)
    data = with_paths(drafted(Path(start.name), start.changes).data, named)
    run = f"twinct run {file} --out out/{start.changes.get('name', start.name)}"
    own = ", for files of yours" if start.changes else ""
    check = f"twinct check {file}".ljust(len(run))
    head = _HEAD.format(name=start.name, own=own, check=check, run=run)
    return "\n".join([head, *_section(data, model, "")]) + "\n"


def _section(
    data: dict[str, Any], model: object, indent: str, explained: set[str] | None = None
) -> Iterator[str]:
    """Yield the lines of a section; its keys are fields of the model.

    In a list, ``explained`` holds the comments so far: no item repeats them.
    """
    for key, value in data.items():
        inner = getattr(model, key, None)
        yield from _comment(model, key, indent, explained)
        if is_mapping(value) and value and isinstance(inner, BaseModel):
            yield f"{indent}{key}:"
            yield from _section(value, inner, f"{indent}  ", explained)
        elif is_list(value) and value and all(map(is_mapping, value)):
            yield f"{indent}{key}:"
            already = set[str]() if explained is None else explained
            for item, its_model in zip(value, inner or [None] * len(value), strict=False):
                yield from _item(item, its_model, f"{indent}  ", already)
        else:
            yield f"{indent}{key}: {written_on_a_line(value)}"
        if not indent:
            yield ""


def _item(item: dict[str, Any], model: object, indent: str, explained: set[str]) -> Iterator[str]:
    """Yield the lines of a section in a list: the first key stands behind a dash."""
    comments = True
    for line in _section(item, model, f"{indent}  ", explained):
        if not comments:
            yield line
        elif line.lstrip().startswith("#"):
            yield f"{indent}{line.lstrip()}"
        else:
            yield f"{indent}- {line.lstrip()}"
            comments = False


def _comment(model: object, key: str, indent: str, explained: set[str] | None) -> Iterator[str]:
    """Yield the description of a key as a comment, unless it stands above."""
    field = type(model).model_fields.get(key) if isinstance(model, BaseModel) else None
    text = " ".join(((field and field.description) or "").split()).replace("``", "")
    if explained is not None and text in explained:
        return
    if explained is not None:
        explained.add(text)
    prefix = f"{indent}# "
    yield from textwrap.wrap(text, WIDTH, initial_indent=prefix, subsequent_indent=prefix)
