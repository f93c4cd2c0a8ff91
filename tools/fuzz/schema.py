"""Random values from a JSON Schema: within its limits, beyond them, and of wrong types."""

from __future__ import annotations

import random
from typing import Any

from mutations import nasty

WRONG = 0.04
"""Share of values that ignore the schema."""

DEEPEST = 12


class Schema:
    """Source of values that a JSON Schema allows, or nearly allows."""

    def __init__(self, schema: dict[str, Any]) -> None:
        """Store the schema."""
        self._whole = schema

    @property
    def sections(self) -> list[str]:
        """Names of the top-level keys."""
        return list(self._whole["properties"])

    def value_at(self, rng: random.Random, key: tuple[str | int, ...]) -> Any:
        """Return a value for a key; any value if the schema lacks the key."""
        part = self._whole
        for step in key:
            branches = [self._resolved(branch) for branch in self._branches(part)]
            if isinstance(step, int):
                inner = [branch["items"] for branch in branches if "items" in branch]
            else:
                named = (branch.get("properties", {}) for branch in branches)
                inner = [properties[step] for properties in named if step in properties]
            if not inner:
                return nasty(rng)
            part = rng.choice(inner)
        return self.value(rng, part)

    def value(self, rng: random.Random, part: dict[str, Any], depth: int = 0) -> Any:
        """Return a value for a part of the schema."""
        if rng.random() < WRONG or depth > DEEPEST:
            return nasty(rng)
        part = self._resolved(rng.choice(self._branches(part)))
        if "const" in part:
            return part["const"]
        if "enum" in part:
            return rng.choice(part["enum"])
        match part.get("type"):
            case "object":
                return self._object(rng, part, depth)
            case "array":
                return self._array(rng, part, depth)
            case "integer" | "number" as kind:
                return _number(rng, part, whole=kind == "integer")
            case "boolean":
                return rng.random() < 0.5
            case "null":
                return None
            case "string":
                return rng.choice(("", "x", "bone", "water", "believed", "data/curve.txt", "a b"))
            case _:
                return nasty(rng)

    def _object(self, rng: random.Random, part: dict[str, Any], depth: int) -> Any:
        tags = ("kind", "method", "algorithm")
        share = rng.random()
        found = {
            name: self.value(rng, inner, depth + 1)
            for name, inner in part.get("properties", {}).items()
            if name in tags or "default" not in inner or rng.random() < share
        }
        if isinstance(other := part.get("additionalProperties"), dict):
            names = rng.sample(("H", "O", "Ca", "Fe", "W", "Xx", ""), rng.randint(0, 3))
            found |= {name: self.value(rng, other, depth + 1) for name in names}
        return found

    def _array(self, rng: random.Random, part: dict[str, Any], depth: int) -> Any:
        if "prefixItems" in part:
            return [self.value(rng, inner, depth + 1) for inner in part["prefixItems"]]
        least = part.get("minItems", 0)
        number = rng.choice((least, least, least + 1, least + 3, max(least - 1, 0)))
        return [self.value(rng, part.get("items", {}), depth + 1) for _ in range(number)]

    def _branches(self, part: dict[str, Any]) -> list[dict[str, Any]]:
        part = self._resolved(part)
        for word in ("anyOf", "oneOf", "allOf"):
            if word in part:
                return [b for branch in part[word] for b in self._branches(branch)]
        return [part]

    def _resolved(self, part: dict[str, Any]) -> dict[str, Any]:
        while "$ref" in part:
            part = self._whole["$defs"][part["$ref"].rpartition("/")[2]]
        return part


def _number(rng: random.Random, part: dict[str, Any], *, whole: bool) -> float:
    low = part.get("minimum", part.get("exclusiveMinimum", -1000))
    high = part.get("maximum", part.get("exclusiveMaximum", max(low, 0) + 1000))
    pick = rng.random()
    if pick < 0.25:
        number = rng.choice((low, high, low - 1, high + 1, low + 1e-9, 0, 1))
    elif pick < 0.5:
        number = rng.choice(
            (1e-9, 1e-6, 1e-3, 0.1, 1, 2, 10, 100, 1e4, 1e5, 1e7, 1e12, 1e200, 1e308)
        )
    else:
        number = low + (high - low) * rng.random() ** 3
    return round(number) if whole else float(number)
