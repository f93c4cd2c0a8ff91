"""Figures of a trial: numbers by dotted name, which follows the nesting of ``metrics.json``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from twinct.evaluation import IMAGE_FIGURES, MOTION_FIGURES
from twinct.scenario import Scenario

_SECTIONS = ("views", "reached", "simulated_seconds", "clearance_mm", "pose_error")
_WITH_ARMS = ("tool_speed_mm_s",)
_IMAGES = ("image", "image_by_geometry", "believed_minus_executed")
_OF_ZERO = ("rmse_rel", "rmse_near_rel", "psnr_db", "ssim", "ssim_near")
_OF_IMAGE = (
    *(one.key for one in IMAGE_FIGURES),
    "signal_error_rel",
    *(f"zero.{name}" for name in _OF_ZERO),
)


def flat_figures(metrics: Mapping[str, Any]) -> dict[str, float | None]:
    """Return the figures that depend on the scenario alone, without seconds and digests."""
    figures: dict[str, float | None] = {}
    for name in (*_IMAGES, *_SECTIONS, *_WITH_ARMS):
        if name in metrics:
            figures |= _flat(name, metrics[name])
    believed = metrics["geometries"]["believed"]["pose_error"]
    return figures | _flat("geometries.believed.pose_error", believed)


def figure_names(scenario: Scenario) -> tuple[str, ...]:
    """Return the names of the figures that a trial of a scenario will have."""
    section = scenario.evaluation
    moves = [one.key for one in MOTION_FIGURES] if scenario.specimen.motion else []
    of_image = [*_OF_IMAGE, *moves, *(section.figure_names() if section else ())]
    names = [f"image.{name}" for name in of_image]
    geometries = scenario.reconstruction.geometries
    if len(geometries) > 1:
        names += [f"image_by_geometry.{g}.{name}" for g in geometries for name in of_image]
    if {"believed", "executed"} <= {*geometries}:
        names += [
            f"believed_minus_executed.{name}" for name in of_image if not name.startswith("zero.")
        ]
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
    return {} if isinstance(value, list) else {name: value}  # a curve is no figure
