"""Names of figures in files of versions 0.1 and 1.0, which said "bone" of any material."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_TODAY = {
    "rmse_bone_rel": "rmse_near_rel",
    "ssim_bone": "ssim_near",
    "mean_bone_rel": "mean_reference_rel",
    "roi_bone_fraction": "roi_reference_fraction",
}


def with_todays_names(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Return figures from a stored file, nested or by dotted name, with the names of today."""
    return {
        # A region may have the name of a figure; its value is a mapping.
        name if isinstance(value, Mapping) else _today(name): _inside(value)
        for name, value in figures.items()
    }


def _inside(value: Any) -> Any:
    return with_todays_names(value) if isinstance(value, Mapping) else value


def _today(name: str) -> str:
    before, dot, last = name.rpartition(".")
    return f"{before}{dot}{_TODAY.get(last, last)}"
