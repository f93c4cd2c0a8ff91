"""Scenarios as version 0.1 wrote them into its results: one flat section for all algorithms.

The section then held every key with its default, ``engine`` and those without effect included; no
person writes all of them, so that they are known by it.
"""

from __future__ import annotations

import hashlib
import json
import logging
from typing import Any, cast

from twinct.scenario.reconstruction import SECTIONS

log = logging.getLogger(__name__)

_ALL = {
    *("algorithm", "engine", "iterations", "relaxation", "order", "subsets", "regularisation"),
    *("weighting", "tv_steps", "window", "nonnegative"),
    *("surroundings", "beam_hardening", "geometry", "grid"),
}

_ORDER = (
    *("algorithm", "engine", "margin_mm", "voxels", "voxel_mm", "iterations", "relaxation"),
    *("order", "subsets", "regularisation", "weighting", "tv_steps", "window", "nonnegative"),
    *("surroundings", "beam_hardening", "kind", "material", "base", "dense", "first_iterations"),
    *("formula", "mass_fractions", "density_g_cm3"),
    *("geometry", "grid", "centre_mm", "rotation_deg"),
)
"""Of the keys of this section and of those in it, in what was hashed; kept is the alphabet's."""


def upgraded(data: dict[str, Any]) -> dict[str, Any]:
    """The same scenario in today's keys; anything else than one of version 0.1 as it is.

    What the algorithm did not use is left out, the engine ``rtk`` is the algorithm ``rtk_sart``,
    and without a ``nonnegative`` the algorithm's own default holds, as then.
    """
    section = data.get("reconstruction")
    if not isinstance(section, dict) or not section.keys() >= _ALL:
        return data
    flat = cast("dict[str, Any]", section)
    name = "rtk_sart" if flat["engine"] == "rtk" else str(flat["algorithm"])
    known = SECTIONS[name].model_fields if name in SECTIONS else flat
    gone = {key for key in _ALL if key not in known} | {"engine"}
    if flat["nonnegative"] is None:
        gone.add("nonnegative")
    names = ", ".join(sorted(gone))
    log.info("reconstruction of version 0.1: %s not used by %s and left out", names, name)
    kept = {key: value for key, value in flat.items() if key not in gone}
    return data | {"reconstruction": kept | {"algorithm": name}}


def volume_digest(scan_digest: str, section: dict[str, Any]) -> str:
    """What version 0.1 knew a volume by: SHA-256 of its scan's digest and its settings as JSON.

    Args:
        scan_digest: that the scan store holds.
        section: ``reconstruction`` as version 0.1 wrote it down.
    """
    text = json.dumps(_in_order(section), separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256((scan_digest + text).encode()).hexdigest()


def _in_order(value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    told = cast("dict[str, Any]", value)
    places = {key: place for place, key in enumerate(_ORDER)}
    ordered = sorted(told, key=lambda key: places.get(key, len(_ORDER)))
    return {key: _in_order(told[key]) for key in ordered}


def advice(key: tuple[str | int, ...], value: Any) -> str:
    """What to do with a key that version 0.1 had and that is gone."""
    if key != ("reconstruction", "engine"):
        return ""
    instead = "use algorithm: rtk_sart" if value == "rtk" else "leave it out"
    return f"there is no such key any more: {instead}"
