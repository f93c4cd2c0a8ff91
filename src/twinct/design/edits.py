"""Edits of a scenario's text, and the changes between two texts."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from copy import deepcopy
from dataclasses import dataclass
from typing import Any, NamedTuple, cast

from twinct.core.errors import ScenarioError
from twinct.core.files.plain_yaml import Key, written_on_a_line
from twinct.core.files.yaml_edit import with_value, without_value
from twinct.scenario import ScenarioText
from twinct.scenario.reading import drafted, key_of, keys_of

FIRST = ("kind", "method", "algorithm")
"""Keys that restart their section, so that others have to be set after them."""


@dataclass(frozen=True)
class Edit:
    """One step of a user.

    Attributes:
        values: new plain values by dotted key, set in this order.
        removed: dotted keys of entries that are removed first.
    """

    values: Mapping[str, Any]
    removed: tuple[str, ...] = ()

    def on(self, source: ScenarioText) -> ScenarioText:
        """Return the text with this edit.

        A key below a list that only an extended file has takes the whole list over.

        Raises:
            ScenarioError: the text cannot be read, or a key leads nowhere.
        """
        text = source.text
        for dotted in (*self.removed, *self.values):
            if not all(step.strip() for step in dotted.split(".")):
                raise ScenarioError(f"{dotted!r}: expected a dotted key, such as detector.columns")
        for dotted in self.removed:
            text = without_value(text, key_of(dotted), source.path)
        for dotted, value in self.values.items():
            key, value = _with_its_list(ScenarioText(source.path, text), key_of(dotted), value)
            text = with_value(text, key, value, source.path)
        return ScenarioText(source.path, text)

    @property
    def words(self) -> str:
        """The edit in one line."""
        said = [f"{key} removed" for key in self.removed]
        said += [f"{key}: {written_on_a_line(value)}" for key, value in self.values.items()]
        return ", ".join(said)


def _with_its_list(source: ScenarioText, key: Key, value: Any) -> tuple[Key, Any]:
    """Return key and value of the outermost list on the way that the text itself lacks, if any."""
    if not any(isinstance(step, int) for step in key):
        return key, value
    own: Any = keys_of(source).data if source.text.strip() else {}
    for depth, step in enumerate(key):
        own = _entry(own, step)
        if own is not None:
            continue
        merged: Any = drafted(source).data
        for place in key[:depth]:
            merged = _entry(merged, place)
        for inner in range(depth, len(key)):
            merged = _entry(merged, key[inner])
            if isinstance(merged, list):
                whole = cast("list[Any]", deepcopy(merged))
                _put(whole, key[inner + 1 :], value, source)
                return key[: inner + 1], whole
    return key, value


def _put(whole: list[Any], key: Key, value: Any, source: ScenarioText) -> None:
    here: Any = whole
    for step in key[:-1]:
        if isinstance(here, dict):
            here = cast("dict[Any, Any]", here).setdefault(step, {})
        else:
            here = _entry(here, step)
    try:
        if isinstance(here, list) and key[-1] == len(cast("list[Any]", here)):
            here.append(value)
        else:
            cast("Any", here)[key[-1]] = value
    except (TypeError, IndexError, KeyError):
        name = ".".join(map(str, key))
        raise ScenarioError(f"{source.path}: {name} leads to no entry of the list") from None


def _entry(data: Any, step: str | int) -> Any:
    if isinstance(data, Mapping):
        return cast("Mapping[Any, Any]", data).get(str(step))
    if isinstance(data, list) and isinstance(step, int) and step < len(cast("list[Any]", data)):
        return data[step]
    return None


class Line(NamedTuple):
    """A line of a comparison; ``mark`` is a blank, ``+`` for a new or ``-`` for a former line."""

    mark: str
    text: str


def compared(before: str, now: str) -> list[Line]:
    """Return all lines of two texts, with the changed ones marked."""
    lines = difflib.ndiff(before.splitlines(), now.splitlines())
    return [Line(line[0], line[2:]) for line in lines if line[0] != "?"]


def overrides_between(before: ScenarioText, now: ScenarioText) -> list[str]:
    """Return the overrides ``KEY=VALUE`` that turn one text into another.

    Raises:
        ScenarioError: a text cannot be read, or a change, such as a removed key, has no override.
    """
    old = keys_of(before).data if before.text.strip() else {}
    found = [
        f"{'.'.join(key)}={written_on_a_line(value)}"
        for key, value in _differences(old, keys_of(now).data, ())
    ]
    if drafted(before, found).data != drafted(now).data:
        raise ScenarioError(
            f"{now.path}: a key was removed, which no option --set can do: save the file instead"
        )
    return found


def _differences(
    old: Any, new: Mapping[str, Any], key: tuple[str, ...]
) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield keys and values that are new, those of kinds first."""
    for name in sorted(new, key=lambda name: name not in FIRST):
        value, before = new[name], old.get(name)
        if isinstance(value, Mapping) and (before is None or isinstance(before, Mapping)):
            inner = cast("Mapping[str, Any]", value)
            yield from _differences(before or {}, inner, (*key, name))
        elif value != before or type(value) is not type(before):
            yield (*key, name), value
