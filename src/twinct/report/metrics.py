"""Figures of a run as plain data: the contract of ``metrics.json``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from twinct.evaluation import ImageFigures, PoseErrors
from twinct.version import __version__

STAGES = ("plan", "motion", "xray", "reconstruction", "total")
"""Stages whose seconds are in every ``metrics.json``."""


def build_metrics(
    *,
    views: int,
    reached: int,
    pose_errors: PoseErrors,
    clearance_mm: ArrayLike,
    image: ImageFigures | Mapping[str, ImageFigures],
    seconds: Mapping[str, float],
    simulated_seconds: float,
    scenario_digest: str,
    real_time_factor: float | None = None,
    **extra: Any,
) -> dict[str, Any]:
    """Collect the figures of a run.

    The result holds only plain values, for strict JSON: a figure that is not finite, such as the
    PSNR of a perfect volume, becomes None.

    Args:
        views: number of views in the trajectory.
        reached: number of acquired views.
        pose_errors: executed against commanded.
        clearance_mm: smallest gap during the move to each view, (views,), mm.
        image: image figures, or the figures for each reconstructed geometry; the volume of the
            first geometry is stored. ``image_by_geometry`` is added for several geometries, and
            ``believed_minus_executed``, the cost of the poses' errors, if both are present.
        seconds: wall-clock seconds of each stage, ``STAGES`` at least.
        simulated_seconds: simulated time of the scan.
        scenario_digest: digest that ties the figures to the scenario.
        real_time_factor: simulated over wall-clock seconds of the motion; by default
            ``simulated_seconds`` over the seconds of ``motion``.
        **extra: further top-level keys.

    Raises:
        ValueError: a stage is missing, there are no image figures, or an extra key is taken.
    """
    if missing := [stage for stage in STAGES if stage not in seconds]:
        raise ValueError(f"seconds lacks {', '.join(missing)}")
    by_geometry = {"": image} if isinstance(image, ImageFigures) else dict(image)
    if not by_geometry:
        raise ValueError("image holds no figures: name at least one geometry")
    if real_time_factor is None:
        motion = seconds["motion"]
        real_time_factor = simulated_seconds / motion if motion > 0 else math.nan
    metrics: dict[str, Any] = {
        "twinct_version": __version__,
        "scenario_digest": scenario_digest,
        "views": views,
        "reached": reached,
        "pose_error": pose_errors.summary(),
        "clearance_mm": {"min": np.min(np.asarray(clearance_mm, dtype=np.float64))},
        "image": next(iter(by_geometry.values())).as_dict(),
        "seconds": dict(seconds),
        "simulated_seconds": simulated_seconds,
        "real_time_factor": real_time_factor,
    }
    metrics |= _compared(by_geometry)
    if taken := sorted(metrics.keys() & extra.keys()):
        raise ValueError(f"extra keys {', '.join(taken)} are taken")
    return plain(metrics | extra)


def _compared(by_geometry: Mapping[str, ImageFigures]) -> dict[str, Any]:
    """Return the figures of all geometries if there are several, and the cost of poses' errors."""
    data: dict[str, Any] = {}
    if len(by_geometry) > 1:
        data["image_by_geometry"] = {name: of.as_dict() for name, of in by_geometry.items()}
    if {"believed", "executed"} <= by_geometry.keys():
        both = (replace(by_geometry[name], zero={}).as_dict() for name in ("believed", "executed"))
        data["believed_minus_executed"] = _difference(*both)
    return data


def _difference(one: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, Any]:
    """Return the differences between two nested dictionaries of numbers.

    Skip curves, and keys that only one of them has.
    """
    differences: dict[str, Any] = {}
    for name in one.keys() & other.keys():
        a, b = one[name], other[name]
        if isinstance(a, Mapping) and isinstance(b, Mapping):
            differences[name] = _difference(a, b)
        elif isinstance(a, float) and isinstance(b, float):
            differences[name] = a - b
    return {
        name: differences[name] for name in one if name in differences and differences[name] != {}
    }


def plain(value: Any) -> Any:
    """Return a value in Python's own types, with None for numbers that are not finite."""
    if isinstance(value, Mapping):
        return {str(key): plain(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [plain(inner) for inner in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value
