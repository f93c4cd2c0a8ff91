"""What an algorithm found out beside the voxels."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

FOUND = ("implants", "passes", "metal_voxels", "prior")
"""What a volume may have among its extras that ``metrics.json`` and the report tell."""


def found_of(told: Mapping[str, Any]) -> dict[str, Any]:
    """Of extras, or of figures: what was found, as far as it was looked for."""
    return {key: told[key] for key in FOUND if key in told}


def with_found(in_words: str, told: Mapping[str, Any]) -> str:
    """How a volume was made, and what was found, in one line; implants have a table."""
    words: list[str] = []
    if "passes" in told:
        words.append(f"{told['passes']} were best")
    if "metal_voxels" in told:
        words.append(f"{told['metal_voxels'] or 'no'} voxels of metal")
    if prior := told.get("prior"):
        words.append(
            f"prior moved by {prior['moved_mm']:.2f} mm, turned by {prior['turned_deg']:.2f} deg"
        )
    return f"{in_words}: {', '.join(words)}" if words else in_words
