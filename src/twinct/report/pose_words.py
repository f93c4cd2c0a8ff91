"""Names of pose errors: each states which poses are compared with which."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

EXECUTED = "executed against commanded"
"""Name of ``pose_error``: how far source and panel were from the poses that were asked for."""


def against_executed(geometry: str) -> str:
    """Return the name of a geometry's pose error, such as "believed against executed"."""
    return f"{geometry} against executed"


def named_pose_errors(metrics: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """Return the summaries of the pose errors that a run has, by name.

    A scan by real arms has measured poses alone: nobody knows those that it executed.

    Args:
        metrics: content of ``metrics.json``.
    """
    if metrics.get("drive"):
        return {"measured against planned": metrics["pose_error"]}
    believed = metrics.get("geometries", {}).get("believed")  # older runs do not say
    other = {} if believed is None else {against_executed("believed"): believed["pose_error"]}
    return {EXECUTED: metrics["pose_error"], **other}
