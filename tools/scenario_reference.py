"""Writes docs/scenario.md: every key of a scenario, from the models that validate it."""

from __future__ import annotations

import sys
import typing
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel
from pydantic_core import PydanticUndefined

from twinct.scenario import Scenario

PAGE = Path(__file__).parents[1] / "docs" / "scenario.md"

HEAD = """# Scenario reference

One YAML file initialises everything. This page is made from the models that validate it
(`make docs`); `twinct schema` prints the same as a JSON Schema, for editors:

```yaml
# yaml-language-server: $schema=twinct.schema.json
extends: paper.yaml     # build on another file, relative to this one
trajectory: {views: 100}
```

`extends` merges mappings key by key and replaces everything else; a section of another `kind`
starts afresh. `--set KEY=VALUE` on the command line overrides a key:
`--set specimen.parts.0.material=water`. Unknown keys are refused. Lengths are mm, angles degrees,
and each key says so in its name. A `path` is relative to the file that names it.
"""


def reference() -> str:
    """The whole page."""
    sections: list[str] = [HEAD]
    seen: set[type[BaseModel]] = set()
    _write(Scenario, "Scenario", sections, seen)
    return "\n".join(sections)


def _write(
    model: type[BaseModel], title: str, sections: list[str], seen: set[type[BaseModel]]
) -> None:
    if model in seen:
        return
    seen.add(model)
    rows = [f"## {title}\n", f"{(model.__doc__ or '').strip()}\n"]
    rows += ["| key | value | default | meaning |", "|---|---|---|---|"]
    inner: list[tuple[type[BaseModel], str]] = []
    for name, info in model.model_fields.items():
        models = _models(info.annotation)
        inner += [(m, f"{_title(title)}{name}{_kind(m)}") for m in models]
        rows.append(
            f"| `{name}` | {_type(info.annotation, info.metadata)} | {_default(info)} "
            f"| {info.description or ''} |"
        )
    sections.append("\n".join(rows) + "\n")
    for other, name in inner:
        _write(other, name, sections, seen)


def _title(title: str) -> str:
    return "" if title == "Scenario" else title.split(" (")[0] + "."


def _kind(model: type[BaseModel]) -> str:
    info = model.model_fields.get("kind")
    return f" (kind: {typing.get_args(info.annotation)[0]})" if info else ""


def _models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [m for arg in typing.get_args(annotation) for m in _models(arg)]


def _type(annotation: Any, metadata: list[Any]) -> str:
    origin, args = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is Literal:
        text = " or ".join(f"`{arg}`" for arg in args)
    elif origin is typing.Annotated:
        text = _type(args[0], list(args[1:]))
    elif origin is tuple:
        many = len(args) == 2 and args[1] is Ellipsis
        text = f"list of {_type(args[0], [])}" if many else f"{len(args)} numbers"
    elif args and origin is not dict:
        text = " or ".join(dict.fromkeys(_type(arg, []) for arg in args if arg is not type(None)))
    elif origin is dict:
        text = "mapping of names to numbers"
    elif isinstance(annotation, type) and issubclass(annotation, BaseModel):
        text = "section"
    else:
        names = {"str": "text", "float": "number", "int": "whole number", "bool": "true or false"}
        name = getattr(annotation, "__name__", str(annotation))
        text = names.get(name, name.lower())
    return text + _bounds(metadata)


def _bounds(metadata: list[Any]) -> str:
    signs = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
    bounds = []
    for item in metadata:
        items = getattr(item, "metadata", None) or [item]
        for bound in items:
            for name, sign in signs.items():
                if (value := getattr(bound, name, None)) is not None:
                    bounds.append(f"{sign} {value:g}")
    return f" {', '.join(bounds)}" if bounds else ""


def _default(info: Any) -> str:
    if info.default_factory is not None:
        return "see its section"
    if info.default is PydanticUndefined:
        return "**needed**"
    if info.default is None or info.default == "":
        return "none"
    if isinstance(info.default, BaseModel) and not hasattr(info.default, "kind"):
        return "see its section"
    return f"`{_plain(info.default)}`"


def _plain(value: Any) -> str:
    if isinstance(value, BaseModel):
        keys = ("kind",) if hasattr(value, "kind") else tuple(type(value).model_fields)
        given = {key: getattr(value, key) for key in keys}
        return f"{{{', '.join(f'{key}: {_plain(item)}' for key, item in given.items())}}}"
    if isinstance(value, tuple):
        return f"[{', '.join(_plain(item) for item in value)}]"
    return f"{value:g}" if isinstance(value, float) else f"{value}"


if __name__ == "__main__":
    PAGE.write_text(reference(), encoding="utf-8")
    sys.stdout.write(f"wrote {PAGE.name}\n")
