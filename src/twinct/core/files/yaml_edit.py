"""Changes of single values in a YAML text; every other character stays, comments included.

The parser says where each value stands, and a change replaces that place alone. The new text is
read again before it is returned: it holds the changed value, and all others as before.
"""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, cast

import yaml

from twinct.core.errors import ScenarioError
from twinct.core.files.plain_yaml import Key, read_text, written, written_on_a_line
from twinct.core.foreign_text import quoted

_PARSER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


@dataclass
class _Node:
    """Place of a value in the text; ``start`` and ``end`` are indices of characters.

    ``entries`` has the entries of a mapping or a list, by name or index. ``begin`` is the start of
    the entry: of the key in a mapping, and of the value elsewhere.
    """

    start: int
    end: int
    column: int
    flow: bool
    mapping: bool = False
    begin: int = 0
    entries: dict[str | int, _Node] = field(default_factory=dict["str | int", "_Node"])

    @property
    def last(self) -> _Node:
        """The last entry."""
        return next(reversed(self.entries.values()))


@dataclass(frozen=True)
class _Splice:
    """Replacement of the characters from ``start`` up to ``end``."""

    start: int
    end: int
    text: str


def with_value(text: str, key: Key, value: Any, where: object, what: str = "scenario") -> str:
    """Return a YAML text in which one value is another one, or a new one.

    Missing sections around the value are added. A section or list of the same entries is changed
    entry by entry.

    Args:
        text: mapping in the subset that ``plain_yaml`` reads; may be empty.
        key: steps to the value: names, and indices of lists.
        value: plain data.
        where: origin of the text, for messages.
        what: noun for the text, for messages.

    Raises:
        ScenarioError: the text cannot be read, the key leads through a plain value or to a missing
            index, or the value cannot be written at its place.
    """
    before = read_text(text, where, what).value
    wanted = _changed(before, key, value, where)
    tree = _tree(text)
    if tree is None or not tree.entries:
        after = _with_line_end(text if tree is None else _cut(text, tree)) + _lines(key, value, 0)
    else:
        after = _applied(text, _splices(text, tree, key, value))
    _require(after, wanted, key, where, what)
    return after


def without_value(text: str, key: Key, where: object, what: str = "scenario") -> str:
    """Return a YAML text without one entry of a mapping or a list; arguments as ``with_value``.

    Raises:
        ScenarioError: the text cannot be read, has no such entry, or the entry cannot be removed.
    """
    wanted = copy.deepcopy(read_text(text, where, what).value)
    around, tree = wanted, _tree(text)
    for step in key[:-1]:
        around = _inner(around, step)
        tree = None if tree is None else tree.entries.get(step)
    if tree is None or key[-1] not in tree.entries:
        raise ScenarioError(f"{where}: {_dotted(key)}: there is no such key to remove")
    del around[key[-1]]
    after = _applied(text, [_removal(text, tree, key[-1])])
    _require(after, wanted, key, where, what)
    return after


def _require(after: str, wanted: Any, key: Key, where: object, what: str) -> None:
    """Raise unless a text holds the wanted data."""
    try:
        same = _as_json(read_text(after, where, what).value) == _as_json(wanted)
    except ScenarioError:
        same = False
    if not same:
        raise ScenarioError(
            f"{where}: {_dotted(key)}: its place in the {what} is written in a way that cannot be "
            "changed from here; edit the file"
        )


def _as_json(data: Any) -> str:
    return json.dumps(data, sort_keys=True)


def _dotted(key: Key) -> str:
    return ".".join(map(str, key))


def _inner(data: Any, step: str | int) -> Any:
    """Return an entry of plain data; None if there is none."""
    if isinstance(data, Mapping):
        return cast("Mapping[Any, Any]", data).get(str(step))
    listed = cast("list[Any]", data) if isinstance(data, list) else []
    return listed[step] if isinstance(step, int) and 0 <= step < len(listed) else None


def _changed(data: Any, key: Key, value: Any, where: object) -> Any:
    """Return plain data with one value changed."""
    changed: Any = {} if data is None else copy.deepcopy(data)
    here = changed
    for depth, step in enumerate(key):
        name = _dotted(key[:depth])
        if isinstance(here, list):
            count = len(cast("list[Any]", here))
            if not isinstance(step, int) or not 0 <= step <= count:
                raise ScenarioError(
                    f"{where}: {name} is a list of length {count}; {quoted(step)} is not an index "
                    f"of it, nor {count}, which adds an entry"
                )
            if step == count:
                cast("list[Any]", here).append(None)
        elif isinstance(here, dict):
            here.setdefault(step, None)
        else:
            raise ScenarioError(f"{where}: {name} is a value and has no keys")
        entries: Any = here
        if depth == len(key) - 1:
            entries[step] = copy.deepcopy(value)
        elif entries[step] is None:
            entries[step] = {}
        here = entries[step]
    return changed


# Places of the values, from the parser's events.


def _tree(text: str) -> _Node | None:
    """Return the tree of places; None if the text holds no value."""
    events = iter(yaml.parse(text, Loader=_PARSER))
    next(events)
    if isinstance(next(events), yaml.StreamEndEvent):
        return None
    first = next(events)
    if isinstance(first, yaml.ScalarEvent) and not first.value and not first.style:
        return None
    return _node(text, first, events)


def _node(text: str, event: Any, events: Iterator[Any]) -> _Node:
    start, end = event.start_mark.index, event.end_mark.index
    if isinstance(event, yaml.ScalarEvent):
        inside = text[start:end]
        return _Node(start, start + len(inside.rstrip()), event.start_mark.column, True)
    mapping = isinstance(event, yaml.MappingStartEvent)
    node = _Node(start, end, event.start_mark.column, bool(event.flow_style), mapping)
    while not isinstance(inner := next(events), yaml.MappingEndEvent | yaml.SequenceEndEvent):
        if mapping:
            begin = inner.start_mark.index
            inside = _node(text, next(events), events)
            node.entries[cast(str, cast(Any, inner).value)] = inside
            inside.begin = begin
        else:
            inside = _node(text, inner, events)
            inside.begin = inside.start
            node.entries[len(node.entries)] = inside
    closed_by = inner.end_mark.index
    node.end = closed_by if node.flow or not node.entries else node.last.end
    return node


# Changes of the text.


def _splices(text: str, node: _Node, key: Key, value: Any) -> list[_Splice]:
    for depth, step in enumerate(key):
        step = str(step) if node.mapping else step
        if step not in node.entries:
            return [_addition(text, node, key[depth:], value)]
        node = node.entries[step]
    return list(_replacements(text, node, value))


def _replacements(text: str, node: _Node, value: Any) -> Iterator[_Splice]:
    """Yield the replacement of a value, or of its entries if they are the same ones."""
    names: list[Any] | None = None
    if isinstance(value, Mapping):
        names = list(cast("Mapping[str, Any]", value))
    elif isinstance(value, list):
        names = list(range(len(cast("list[Any]", value))))
    if names and names == list(node.entries) and node.mapping == isinstance(value, Mapping):
        for name in names:
            yield from _replacements(text, node.entries[name], value[name])
        return
    line = written_on_a_line(value)
    if node.start == node.end:  # nothing stands behind the colon
        yield _Splice(node.start, node.end, f" {line}")
    elif text[node.start : node.end] != line:
        start = node.start
        if not node.flow and text[node.begin : start].count("\n"):  # it begins below its key
            start = text.index(":", node.begin) + 1
            line = f" {line}"
        yield _Splice(start, node.end, line)


def _addition(text: str, node: _Node, key: Key, value: Any) -> _Splice:
    """Return the insertion of a new entry at the end of a mapping or list."""
    if not (node.entries or text[node.start : node.end].strip()):  # a section without keys
        return _Splice(node.start, node.end, f" {written_on_a_line(_nested(key, value))}")
    if node.flow:
        entry = written_on_a_line(_nested(key, value))
        entry = entry[1:-1] if node.mapping else written_on_a_line(_nested(key[1:], value))
        if not node.entries:
            return _Splice(node.start + 1, node.end - 1, entry)
        return _Splice(node.last.end, node.last.end, f", {entry}")
    if node.mapping and node.column == 0:  # of the whole text, behind its last comment
        ended = text.endswith("\n")
        at = len(text) - 1
    else:
        at = text.find("\n", node.end)
        ended = at >= 0
    lines = (
        _lines(key, value, node.column)
        if node.mapping
        else f"{' ' * node.column}- {written_on_a_line(_nested(key[1:], value))}\n"
    )
    return _Splice(at + 1, at + 1, lines) if ended else _Splice(len(text), len(text), f"\n{lines}")


def _removal(text: str, around: _Node, name: str | int) -> _Splice:
    """Return the removal of an entry."""
    names = list(around.entries)
    place, node = names.index(name), around.entries[name]
    if len(names) == 1:
        start = around.start
        return _Splice(start, around.end, "{}" if around.mapping else "[]")
    if around.flow:
        if place:
            return _Splice(around.entries[names[place - 1]].end, node.end, "")
        return _Splice(node.begin, around.entries[names[1]].begin, "")
    start = text.rfind("\n", 0, node.begin) + 1
    if around.mapping and text[start : node.begin].strip():  # it stands behind a dash
        return _Splice(node.begin, around.entries[names[1]].begin, "")
    end = text.find("\n", node.end)
    return _Splice(start, len(text) if end < 0 else end + 1, "")


def _nested(key: Key, value: Any) -> Any:
    for step in reversed(key):
        value = {str(step): value}
    return value


def _lines(key: Key, value: Any, column: int) -> str:
    """Return new lines at a column: short lists and sections stand on one line."""
    entry = _nested(key, value)
    inner = entry[str(key[0])]
    nested = isinstance(inner, Mapping | list) and len(cast("Any", inner)) > 0
    text = written(entry, short=True) if nested else written_on_a_line(entry)[1:-1]
    lines = text.splitlines()
    return "".join(f"{' ' * column}{line}\n" for line in lines)


def _cut(text: str, node: _Node) -> str:
    """Return the text without an empty mapping."""
    return text[: node.start] + text[node.end :]


def _with_line_end(text: str) -> str:
    return text if not text or text.endswith("\n") else text + "\n"


def _applied(text: str, splices: list[_Splice]) -> str:
    for one in sorted(splices, key=lambda one: -one.start):
        text = text[: one.start] + one.text + text[one.end :]
    return text
