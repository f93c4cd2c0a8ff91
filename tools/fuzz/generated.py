"""Fuzzing of scenarios with values that hypothesis generates from the JSON Schema.

Each must load, or be refused with a clear message. ``mutants`` is also tried by the tests.
"""

from __future__ import annotations

import copy
import json
import random
from pathlib import Path
from typing import Any

from cases import Case
from hypothesis import strategies as st
from mutations import NASTY_TEXTS, number_near
from scenario_files import Kind as ScenarioFiles
from scenario_files import at, keys_of
from schema import NASTY, Schema, drawn

from twinct.scenario import load_scenario

STEPS = st.sampled_from(("0", "x", "", "-1", "²", "\u0663", "9" * 5000)) | st.text(max_size=9)
"""Last steps of dotted keys, such as indices of lists."""

ADDED = st.sampled_from(("x", "kind", "path", "", "1", "a.b", "x" * 60_000)) | st.text(max_size=9)
"""Names of further keys."""

FILES = 0.1
"""Share of cases that write the scenario to a file and weigh it; the others only load it."""

CHANGES = ("nasty", "near", "schema", "schema", "out", "add", "rename", "section")

Mutant = tuple[dict[str, Any], tuple[str, ...], str]
"""Data of a scenario, overrides, and a description of the changes."""


class Kind(ScenarioFiles):
    """Valid scenarios with a few changes, and overrides."""

    def __init__(self, material: Path) -> None:
        """See ``scenario_files.Kind``."""
        super().__init__(material)
        self.mutants = mutants(self.schema, self.data)

    def case(self, rng: random.Random, folder: Path) -> Case:
        """Make a case with changed values, sections and overrides."""
        data, overrides, told = drawn(rng, self.mutants)
        if rng.random() < FILES:
            return self.loaded(rng, folder, self.text_of(data), overrides, told)
        return Case(told, lambda: _loaded(data, overrides))


def _loaded(data: dict[str, Any], overrides: tuple[str, ...]) -> str:
    load_scenario(data, overrides)
    return "scenario"


@st.composite
def mutants(draw: st.DrawFn, schema: Schema, scenarios: list[dict[str, Any]]) -> Mutant:
    """Return a scenario with one to six changed values, and up to two overrides."""
    data = copy.deepcopy(draw(st.sampled_from(scenarios)))
    told: list[str] = []
    for _ in range(draw(st.sampled_from((0, 1, 1, 1, 2, 4)))):
        if keys := list(keys_of(data)):
            key = draw(st.sampled_from(keys))
            _change(draw, schema, data, key, draw(st.sampled_from(CHANGES)))
            told.append(".".join(map(str, key))[:200])
    number = draw(st.sampled_from((0, 0, 0, 1, 2)))
    found = tuple(draw(overrides(schema, scenarios)) for _ in range(number))
    return data, found, f"values: {', '.join(told)}"


def _change(
    draw: st.DrawFn, schema: Schema, data: dict[str, Any], key: tuple[str | int, ...], how: str
) -> None:
    """Change one value; values are copied, as later changes may reach into them."""
    around, name = at(data, key[:-1]), key[-1]
    old = around[name]
    match how:
        case "near" if isinstance(old, int | float) and not isinstance(old, bool):
            around[name] = number_near(draw(st.randoms(use_true_random=False)), old)
        case "schema":
            around[name] = copy.deepcopy(draw(schema.at(key)))
        case "section":
            section = draw(st.sampled_from(schema.sections))
            data[section] = copy.deepcopy(draw(schema.at((section,))))
        case "out":
            del around[name]
        case "add" if isinstance(old, dict):
            old[draw(ADDED)] = copy.deepcopy(draw(NASTY))
        case "rename" if isinstance(around, dict):
            around[f"{name}x"] = around.pop(name)
        case _:
            around[name] = copy.deepcopy(draw(NASTY))


@st.composite
def overrides(draw: st.DrawFn, schema: Schema, scenarios: list[dict[str, Any]]) -> str:
    """Return one ``KEY=VALUE``, or a text that is none."""
    if draw(st.integers(0, 9)) == 7:
        return draw(st.sampled_from(("", "=", "a", ".=1", "a.=1", "a..b=1", "\0=\0")) | st.text())
    key = draw(st.sampled_from(list(keys_of(draw(st.sampled_from(scenarios))))))
    steps = list(map(str, key[: draw(st.integers(1, len(key)))]))
    steps += draw(st.lists(STEPS, max_size=1))
    value = draw(st.sampled_from(NASTY_TEXTS) | schema.at(key).map(json.dumps) | st.text())
    return f"{'.'.join(steps)}={value}"
