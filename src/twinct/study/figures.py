"""The figures of a trial: numbers by dotted name, as ``metrics.json`` nests them."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from twinct.evaluate import ImageFigures
from twinct.scenario import Scenario

_SECTIONS = ("views", "reached", "simulated_seconds", "clearance_mm", "pose_error")
_WITH_ARMS = ("tool_speed_mm_s",)
_IMAGES = ("image", "image_by_geometry")


def flat_figures(metrics: Mapping[str, Any]) -> dict[str, float | None]:
    """What depends on the scenario alone: no seconds, no digests."""
    found: dict[str, float | None] = {}
    for name in (*_IMAGES, *_SECTIONS, *_WITH_ARMS):
        if name in metrics:
            found |= _flat(name, metrics[name])
    believed = metrics["geometries"]["believed"]["pose_error"]
    return found | _flat("geometries.believed.pose_error", believed)


def figure_names(scenario: Scenario) -> tuple[str, ...]:
    """The figures that a trial of a scenario will have."""
    of_image = [field.name for field in dataclasses.fields(ImageFigures)]
    names = [f"image.{name}" for name in of_image]
    geometries = scenario.reconstruction.geometries
    if len(geometries) > 1:
        names += [f"image_by_geometry.{g}.{name}" for g in geometries for name in of_image]
    names += ["views", "reached", "simulated_seconds", "clearance_mm.min"]
    names += [
        f"{of}.{side}.{what}.{figure}"
        for of in ("pose_error", "geometries.believed.pose_error")
        for side in ("source", "detector")
        for what in ("position_mm", "rotation_deg")
        for figure in ("mean", "std", "max")
    ]
    if scenario.cell.kind == "arms" and getattr(scenario.trajectory, "views", 2) != 1:
        names += [
            f"tool_speed_mm_s.{s}.{f}" for s in ("source", "detector") for f in ("mean", "max")
        ]
    return tuple(names)


def _flat(name: str, value: Any) -> dict[str, float | None]:
    if isinstance(value, Mapping):
        return {k: v for key in value for k, v in _flat(f"{name}.{key}", value[key]).items()}
    return {name: value}
