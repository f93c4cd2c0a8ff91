"""A safe subset of YAML: mappings, lists, texts, numbers, truth values and null, and nothing else.

Plain words have the meaning of the core schema of YAML 1.2 (section 10.3.2): ``no``,
``2020-01-01``, ``1:30`` and ``1_000`` are texts, and 1e-3 is a number. Tags, anchors, merge keys,
second documents and repeated keys are refused. Size, depth and number of values are limited while
the file is read, before any of it is used.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import yaml

from twinct.core.errors import ScenarioError
from twinct.core.files.boundary import read_text as text_of
from twinct.core.foreign_text import quoted

LARGEST_BYTES = 2**20
"""Largest file; a study with 10,000 values has a tenth of this size."""

DEEPEST = 20
"""Deepest nesting in a file; a scenario's own sections need six levels."""

MOST_VALUES = 100_000
"""Largest number of values in a file, keys included."""

MOST_DIGITS = 400
"""Largest number of digits; the largest floating-point number has 309."""

Key = tuple[str | int, ...]

_WORDS: dict[str, bool | None] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}
_WHOLE = re.compile(r"[-+]?[0-9]+")
_IN_BASE = re.compile(r"0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?")
_ENDLESS = re.compile(r"[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)")
_UNFIT = re.compile("[\0-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")
"""Characters that neither a name nor a description may contain."""

# The same parser in C is thirty times as fast, and the wheels contain it.
_PARSER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


@dataclass(frozen=True)
class PlainYaml:
    """Content of a YAML text.

    Attributes:
        value: dicts with texts as keys, lists, str, int, float, bool and None, not shared.
        lines: line on which each value begins, by its keys from the outermost; 1 is the first.
    """

    value: Any
    lines: dict[Key, int]


def read_file(path: Path, what: str) -> PlainYaml:
    """Read a YAML file, which messages call ``what``.

    Raises:
        ScenarioError: the file cannot be read, or holds more than plain data; names file and line.
    """
    return read_text(read_file_text(path, what), path, what)


def read_file_text(path: Path, what: str) -> str:
    """Return the text of a YAML file, unread.

    Raises:
        ScenarioError: there is no such file, or it is too large or no text.
    """
    return text_of(path, f"{path}: the {what}", LARGEST_BYTES, ScenarioError)


def read_text(text: str, where: object, what: str) -> PlainYaml:
    """Read a YAML text that came from ``where``.

    Raises:
        ScenarioError: as ``read_file``.
    """
    return _Reader(text, where, what, lines=True).read()


def read_value(text: str, where: str) -> Any:
    """Return the value of a short text that a user typed.

    Raises:
        ScenarioError: as ``read_file``; begins with ``where``.
    """
    return _Reader(text, where, "value", lines=False).read().value


class _Writer(yaml.SafeDumper):
    """Dumper that also quotes texts that are numbers only in YAML 1.2, and writes no anchors."""

    def ignore_aliases(self, data: Any) -> bool:
        """Return True: a value that occurs twice is written twice."""
        return True


_resolvers: Any = _Writer
for _pattern in (_FLOAT, _IN_BASE):
    _whole_text = re.compile(f"^(?:{_pattern.pattern})$")
    _resolvers.add_implicit_resolver("tag:yaml.org,2002:float", _whole_text, list("-+.0123456789"))


def written(data: Any, *, short: bool = False) -> str:
    """Return the text that ``read_file`` reads back; ``short``: innermost sections on one line."""
    flow = None if short else False
    return yaml.dump(
        data, Dumper=_Writer, sort_keys=False, allow_unicode=True, default_flow_style=flow
    )


def written_on_a_line(value: Any) -> str:
    """Return the text of a value as it may stand behind a key, or in a list in brackets."""
    text = yaml.dump(
        [value],
        Dumper=_Writer,
        sort_keys=False,
        allow_unicode=True,
        default_flow_style=True,
        width=2**31,
    )
    return text.rstrip("\n")[1:-1]


class _Reader:
    """One pass over the events of a text, in which only the values are stored."""

    def __init__(self, text: str, where: object, what: str, *, lines: bool) -> None:
        self._text, self._where, self._what, self._tell_lines = text, where, what, lines
        self._lines: dict[Key, int] = {}
        self._left = MOST_VALUES
        self._events: Iterator[Any] = iter(())

    def read(self) -> PlainYaml:
        """Return the content of the whole text; the value is None if it is empty."""
        for match in _UNFIT.finditer(self._text):
            line = self._text.count("\n", 0, match.start()) + 1
            self._refuse(line, (), f"the character {match[0]!r} is not allowed in a {self._what}")
        self._events = self._parsed()
        next(self._events)  # the stream's start
        value, event = None, next(self._events)
        if not isinstance(event, yaml.StreamEndEvent):
            value = self._value(next(self._events), ())
            next(self._events)  # the document's end
            event = next(self._events)
            if not isinstance(event, yaml.StreamEndEvent):
                self._refuse(_line(event), (), "not valid YAML: a second document begins")
        return PlainYaml(value, self._lines)

    def _parsed(self) -> Iterator[Any]:
        try:
            yield from yaml.parse(self._text, Loader=_PARSER)
        except yaml.YAMLError as error:
            mark = getattr(error, "problem_mark", None)
            problem = getattr(error, "problem", None) or getattr(error, "reason", None) or "?"
            last = max(len(self._text.splitlines()), 1)  # the end is no separate line
            line = min(mark.line + 1, last) if mark else None
            if line and re.match(r" *\t", self._text.splitlines()[line - 1]):
                problem = "a line begins with a tab; indent it with spaces"
            self._refuse(line, (), f"not valid YAML: {problem}")

    def _value(self, event: Any, key: Key) -> Any:
        self._lines[key] = line = _line(event)
        self._left -= 1
        if self._left < 0:
            self._refuse(line, key, f"a {self._what} has at most {MOST_VALUES} keys and values")
        if len(key) > DEEPEST:
            deep = f"nested too deep: a {self._what} has at most {DEEPEST} levels"
            self._refuse(line, key[:3], deep)
        if isinstance(event, yaml.AliasEvent):
            self._refuse(
                line, key, f"*{event.anchor}: aliases are not supported; write out the value"
            )
        event = cast(Any, event)
        if event.anchor is not None:
            self._refuse(
                line, key, f"&{event.anchor}: anchors are not supported; write out the value"
            )
        if event.tag is not None:
            self._refuse(line, key, f"{event.tag}: tags are not supported; remove it")
        if isinstance(event, yaml.MappingStartEvent):
            return self._mapping(key)
        if isinstance(event, yaml.SequenceStartEvent):
            items: list[Any] = []
            while not isinstance(inner := next(self._events), yaml.SequenceEndEvent):
                items.append(self._value(inner, (*key, len(items))))
            return items
        text = self._fit(cast(str, event.value), line, key)
        return text if event.style else self._meant(text, line, key)

    def _mapping(self, key: Key) -> dict[str, Any]:
        data: dict[str, Any] = {}
        while not isinstance(event := next(self._events), yaml.MappingEndEvent):
            line = _line(event)
            if not isinstance(event, yaml.ScalarEvent) or event.anchor or event.tag:
                self._refuse(line, key, "a key must be text without a tag or an anchor")
            name = self._fit(str(event.value), line, key)
            if name == "<<" and not event.style:
                self._refuse(line, key, "merge keys (<<) are not supported; write out the keys")
            if name in data:
                self._refuse(line, key, f"the key {quoted(name)} appears twice")
            data[name] = self._value(next(self._events), (*key, name))
        return data

    def _fit(self, text: str, line: int, key: Key) -> str:
        if match := _UNFIT.search(text):
            self._refuse(line, key, f"the character {match[0]!r} is not allowed in a {self._what}")
        return text

    def _meant(self, text: str, line: int, key: Key) -> Any:
        """Return the value of a word without quotes."""
        if text in _WORDS:
            return _WORDS[text]
        if text[0] not in "-+.0123456789":
            return text
        if len(text) > MOST_DIGITS and (_FLOAT.fullmatch(text) or _IN_BASE.fullmatch(text)):
            self._refuse(
                line, key, f"the number has {len(text)} digits; the limit is {MOST_DIGITS}"
            )
        if _WHOLE.fullmatch(text):
            digits = text.lstrip("+-")
            if len(digits) > 1 and digits[0] == "0":
                advice = "remove it, or quote the value if it is not a number"
                self._refuse(line, key, f"{text} begins with a zero: {advice}")
            return int(text)
        if _IN_BASE.fullmatch(text):
            return int(text, 0)
        if _FLOAT.fullmatch(text):
            return float(text)
        return float(text.replace(".", "", 1)) if _ENDLESS.fullmatch(text) else text

    def _refuse(self, line: int | None, key: Key, why: str) -> None:
        at = f":{line}" if self._tell_lines and line is not None else ""
        name = ".".join(map(str, key))
        raise ScenarioError(f"{self._where}{at}: {name + ': ' if name else ''}{why}")


def _line(event: Any) -> int:
    return event.start_mark.line + 1
