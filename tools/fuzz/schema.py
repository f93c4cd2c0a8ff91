"""Strategies of hypothesis for values that a JSON Schema allows, nearly allows, or does not."""

from __future__ import annotations

import functools
import random
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st
from mutations import NASTY_VALUES

MOST_BYTES = 4096
"""Size of the random bytes from which a value is drawn; larger values are cut off by hypothesis."""

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=50),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=9), inner, max_size=4)
    ),
    max_leaves=8,
)
"""Any plain data."""

NASTY = st.sampled_from(NASTY_VALUES) | JSON
NAMES = st.sampled_from(("", "x", "bone", "water", "believed", "data/curve.txt", "a b")) | st.text()
SYMBOLS = st.sampled_from(("H", "O", "Ca", "Fe", "W", "Xx", ""))
TAGS = ("kind", "method", "algorithm")


class Schema:
    """Source of strategies for the parts of a JSON Schema.

    Attributes:
        sections: top-level keys.
    """

    def __init__(self, schema: dict[str, Any]) -> None:
        """Store the schema."""
        self._whole = schema
        self.sections = list(schema["properties"])
        self._by_ref: dict[str, st.SearchStrategy[Any]] = {}

    @functools.cache  # noqa: B019 - as long as the schema
    def at(self, key: tuple[str | int, ...]) -> st.SearchStrategy[Any]:
        """Return a strategy for a key; any value if the schema lacks the key."""
        parts = [self._whole]
        for step in key:
            inner: list[dict[str, Any]] = []
            for part in (branch for around in parts for branch in self._branches(around)):
                if isinstance(step, int) and "items" in part:
                    inner.append(part["items"])
                elif step in part.get("properties", {}):
                    inner.append(part["properties"][step])
            parts = inner
        return st.one_of([self._of(part) for part in parts]) if parts else NASTY

    def _of(self, part: dict[str, Any]) -> st.SearchStrategy[Any]:
        """Return a strategy for a part of the schema; one of 24 values ignores the part."""
        if "$ref" in part:
            name = part["$ref"].rpartition("/")[2]
            if name not in self._by_ref:
                self._by_ref[name] = st.deferred(lambda: self._of(self._whole["$defs"][name]))
            return self._by_ref[name]
        for word in ("anyOf", "oneOf", "allOf"):
            if word in part:
                return st.one_of([self._of(branch) for branch in part[word]])
        allowed = self._allowed(part)
        return st.integers(1, 24).flatmap(lambda pick: NASTY if pick == 7 else allowed)

    def _allowed(self, part: dict[str, Any]) -> st.SearchStrategy[Any]:
        if "const" in part or "enum" in part:
            return st.sampled_from(part.get("enum", [part.get("const")]))
        match part.get("type"):
            case "object":
                return self._object(part)
            case "array" if "prefixItems" in part:
                return st.tuples(*map(self._of, part["prefixItems"])).map(list)
            case "array":
                least = part.get("minItems", 0)
                return st.lists(
                    self._of(part.get("items", {})), min_size=max(least - 1, 0), max_size=least + 3
                )
            case "integer":
                return _numbers(part, st.integers)
            case "number":
                return _numbers(part, st.floats) | _numbers(part, st.integers)
            case "boolean":
                return st.booleans()
            case "null":
                return st.none()
            case "string":
                return NAMES
            case _:
                return NASTY

    def _object(self, part: dict[str, Any]) -> st.SearchStrategy[Any]:
        properties = part.get("properties", {})
        always = {n for n, inner in properties.items() if n in TAGS or "default" not in inner}
        of = {name: self._of(inner) for name, inner in properties.items()}
        found = st.fixed_dictionaries(
            {name: of[name] for name in always},
            optional={name: of[name] for name in of if name not in always},
        )
        other = part.get("additionalProperties")
        if not isinstance(other, dict):
            return found
        more = st.dictionaries(SYMBOLS, self._of(other), max_size=3)
        return st.tuples(found, more).map(lambda two: two[0] | two[1])

    def _branches(self, part: dict[str, Any]) -> list[dict[str, Any]]:
        while "$ref" in part:
            part = self._whole["$defs"][part["$ref"].rpartition("/")[2]]
        for word in ("anyOf", "oneOf", "allOf"):
            if word in part:
                return [b for branch in part[word] for b in self._branches(branch)]
        return [part]


def _numbers(part: dict[str, Any], kind: Any) -> st.SearchStrategy[Any]:
    """Return numbers within the limits, the limits themselves and those next to them, and any."""
    low = part.get("minimum", part.get("exclusiveMinimum"))
    high = part.get("maximum", part.get("exclusiveMaximum"))
    limits = [x + by for x in (low, high) if x is not None for by in (-1, -1e-9, 0, 1e-9, 1)]
    if kind is st.integers:
        low, high = (None if x is None else round(x) for x in (low, high))
        limits = [round(limit) for limit in limits]
    inside = kind(low, high) | kind(low, low + 100 if low is not None else 100)
    return inside | st.sampled_from(limits) | kind() if limits else inside | kind()


@functools.cache
def _drawer(strategy: st.SearchStrategy[Any]) -> tuple[Any, list[Any]]:
    found: list[Any] = []

    @settings(database=None, deadline=None)
    @given(strategy)
    def take(value: Any) -> None:
        found.append(value)

    test: Any = take
    return test.hypothesis.fuzz_one_input, found


def drawn(rng: random.Random, strategy: st.SearchStrategy[Any]) -> Any:
    """Return a value of a strategy, determined by ``rng`` alone."""
    draw, found = _drawer(strategy)
    found.clear()
    size = MOST_BYTES
    while not found:  # hypothesis draws nothing if the bytes do not suffice
        draw(rng.randbytes(size))
        size *= 2
    return found[0]
