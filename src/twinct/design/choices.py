"""Choices of a design from lists: arms, room, table, specimen, material, and rails.

Each choice returns plain values by dotted key, which are one edit.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from twinct.robots.sections.cell import known_arms
from twinct.scenario import Cell, Rail, Scenario, scenario_names
from twinct.scenario.catalogue import scenario_file
from twinct.scenario.reading import drafted
from twinct.specimen.materials import material_names

Values = Mapping[str, Any]

ROOMS = ("plain", "operating")
ARMS = ("source_arm", "detector_arm")

SHAPES: Mapping[str, Mapping[str, Any]] = {
    "skull": {"kind": "skull"},
    "sphere, 60 mm": {"kind": "sphere", "radius_mm": 30},
    "cylinder, 80 x 120 mm": {"kind": "cylinder", "radius_mm": 40, "height_mm": 120},
    "box, 100 mm": {"kind": "box", "size_mm": [100, 100, 100]},
}
"""Specimens of one part."""

RAIL_MM = (-500.0, 500.0)
"""Range of a rail that has just been added."""


def arm_models() -> tuple[str, ...]:
    """Return the arms that a scenario can name."""
    return tuple(known_arms())


def of_arm(scenario: Scenario, arm: str, model: str) -> Values:
    """Return the keys that make an arm another model; bases and tools stay where they are."""
    cell = scenario.cell
    if not isinstance(cell, Cell) or getattr(cell, arm).model == model:
        return {}
    return {f"cell.{arm}.model": model}


def of_room(scenario: Scenario, room: str) -> Values:
    """Return the keys that furnish the room."""
    cell = scenario.cell
    if not isinstance(cell, Cell) or cell.room == room:
        return {}
    return {"cell.room": room}


def of_table(scenario: Scenario, present: bool) -> Values:
    """Return the keys that bring or remove the table."""
    cell = scenario.cell
    if not isinstance(cell, Cell) or cell.table.present == present:
        return {}
    return {"cell.table.present": present}


def of_rail(scenario: Scenario, arm: str, range_mm: tuple[float, float] | None) -> Values:
    """Return the keys that put an arm on a rail, change its range, or, with None, take it off."""
    cell = scenario.cell
    if not isinstance(cell, Cell):
        return {}
    rail: Rail | None = getattr(cell, arm).rail
    key = f"cell.{arm}.rail"
    if range_mm is None:
        return {} if rail is None else {key: None}
    if rail is None:
        return {key: {"range_mm": list(range_mm)}}
    return {} if rail.range_mm == range_mm else {f"{key}.range_mm": list(range_mm)}


@cache
def specimen_names() -> tuple[str, ...]:
    """Return the specimens that twinct brings: simple shapes, and those of built-in scenarios."""
    found: dict[str, Mapping[str, Any]] = {}
    for name in scenario_names():
        parts = _parts_of(name)
        if parts and parts not in found.values():
            found[f"of scenario {name}"] = parts
    return (*SHAPES, *found)


@cache
def _parts_of(name: str) -> Mapping[str, Any]:
    """Return the specimen of a built-in scenario, unless it needs files."""
    stated = drafted(scenario_file(Path(name))).data.get("specimen", {})
    needs_file = any("path" in part.get("shape", {}) for part in stated.get("parts", ()))
    return {} if needs_file or "parts" not in stated else stated


def of_specimen(scenario: Scenario, name: str) -> Values:
    """Return the keys that put one of these specimens in the place of the present one."""
    if name in SHAPES:
        return with_parts(scenario, [{"shape": dict(SHAPES[name]), "material": "bone"}])
    stated = _parts_of(name.removeprefix("of scenario "))
    values = with_parts(scenario, stated["parts"])
    return {
        **values,
        **({"specimen.reference": stated["reference"]} if "reference" in stated else {}),
    }


def with_parts(scenario: Scenario, parts: list[Any]) -> dict[str, Any]:
    """Return the keys that replace all parts; what names a former part becomes the default."""
    values: dict[str, Any] = {"specimen.parts": parts}
    if scenario.specimen.reference:
        values["specimen.reference"] = ""
    if scenario.specimen.motion is not None:
        values["specimen.motion"] = None
    return values


def materials_of(scenario: Scenario) -> dict[str, str]:
    """Return the parts of one material whose material has a name, each with this name."""
    return {
        f"{k}: {part.label}": part.material
        for k, part in enumerate(scenario.specimen.parts)
        if part.homogeneous and isinstance(part.material, str)
    }


def all_materials() -> tuple[str, ...]:
    """Return the names of materials."""
    return material_names()


def of_material(scenario: Scenario, part: str, material: str) -> Values:
    """Return the keys that change the material of a part, named as ``materials_of`` does."""
    if materials_of(scenario).get(part) in (None, material):
        return {}
    return {f"specimen.parts.{part.partition(':')[0]}.material": material}
