"""Results of an algorithm beside the voxels."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

ALGORITHM_RESULTS = (
    "implants",
    "passes",
    "change",
    "metal_voxels",
    "metal_density_rel",
    "metal_thin_voxels",
    "prior",
    "denoising",
    "regularisation",
    "unexplained",
    "diagnosis",
    "warnings",
)
"""Extras of a volume that ``metrics.json`` and the report list."""


def algorithm_results(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the results among extras or figures, as far as there are any."""
    return {key: data[key] for key in ALGORITHM_RESULTS if key in data}


def with_results(in_words: str, data: Mapping[str, Any]) -> str:
    """Add results to the description of a volume, in one line; implants have a table instead."""
    words: list[str] = []
    if "passes" in data:
        words.append("1 pass" if data["passes"] == 1 else f"{data['passes']} passes")
    if "change" in data:
        words.append(f"the last of which changed it by {100 * data['change']:.2g} %")
    if "metal_voxels" in data:
        words.append(f"{data['metal_voxels'] or 'no'} metal voxels")
    if density := data.get("metal_density_rel"):
        words.append(f"metal with {density:.2f} times the attenuation of the material named")
    if thin := data.get("metal_thin_voxels"):
        words.append(f"{thin} metal voxels too thin for a density")
    if prior := data.get("prior"):
        words.append(
            f"prior moved by {prior['moved_mm']:.2f} mm, turned by {prior['turned_deg']:.2f} deg"
        )
        if ratio := prior.get("left_out_ratio"):
            words.append(f"share of the prior {prior['share']:g}")
            words.append(f"residual of left-out views {ratio:.2f} times that without the prior")
    if strength := data.get("regularisation"):
        source = {"photons": "from the photons", "air": "from air in the projections"}
        why = source.get(strength["from"], "since the noise is unknown")
        words.append(f"regularisation {strength['strength']:.2g}, {why}")
        if strength.get("factor"):
            words[-1] += f" and left-out views (factor {strength['factor']:.2g})"
        else:
            words[-1] += ", without a trial on left-out views"
    words += [f"warning: {one}" for one in data.get("warnings", ())]
    return f"{in_words}: {', '.join(words)}" if words else in_words
