"""Scenarios in the results of earlier versions.

Those of 0.1 have one flat section for all algorithms. It holds every key with its default,
including ``engine`` and keys without effect. Nobody writes all of them by hand, so they identify
such a scenario.
"""

from __future__ import annotations

import hashlib
import json
import logging
from typing import Any, cast

from twinct.recon.sections.reconstruction import SECTIONS

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
"""Order of the keys, nested ones included, in the hashed text; stored keys are alphabetical."""


_FORMER = {
    "fast": {"coarse_passes", "first_relaxation", "denoising", "stop"},
    "fista_tv": {"iterations", "regularisation", "subsets", "weighting", "tv_steps", "nonnegative"},
}
"""Keys of ``fast`` while rules chose its passes, and of ``fista_tv`` while it was a solver of its
own; a result holds them all, with defaults."""

_LATER = {"fast": set[str](), "fista_tv": {"rounds", "huber"}}
"""Keys that only some of those results hold."""


_DETECTOR = {
    *("columns", "rows", "pixel_pitch_mm", "response", "pixel_samples", "binning"),
    *("point_spread", "noise", "readout", "bad_pixels", "lag", "correction", "scatter"),
}
"""Keys of a detector that any result holds, with defaults."""


def upgraded(data: dict[str, Any]) -> dict[str, Any]:
    """Return a scenario of an earlier version in today's keys, and any other scenario unchanged.

    Version 1.0 said of each specimen that it is not unknown. For version 0.1, leave out settings
    that the algorithm did not use, and turn the engine ``rtk`` into the algorithm ``rtk_sart``.
    Leave out keys that ``fast`` and ``fista_tv`` no longer have, and the kernel of scatter.
    Without ``nonnegative``, the algorithm's own default holds, as in version 0.1.
    """
    stated = data.get("specimen")
    if isinstance(stated, dict):
        specimen = cast("dict[str, Any]", stated)
        if specimen.get("unknown") is False:
            data = data | {"specimen": {k: v for k, v in specimen.items() if k != "unknown"}}
    panel = data.get("detector")
    if isinstance(panel, dict) and panel.keys() >= _DETECTOR:
        detector = cast("dict[str, Any]", panel)
        scatter = cast("dict[str, Any]", detector["scatter"] or {})
        if scatter.get("kind") == "kernel":
            log.warning("the scatter of this scan is from a kernel that is gone: scatter is null")
            data = data | {"detector": detector | {"scatter": None}}
    section = data.get("reconstruction")
    if not isinstance(section, dict):
        return data
    stored = cast("dict[str, Any]", section)
    flat = _without_former(stored)
    if not stored.keys() >= _ALL:
        return data if flat is stored else data | {"reconstruction": flat}
    name = "rtk_sart" if flat["engine"] == "rtk" else str(flat["algorithm"])
    known = SECTIONS[name].model_fields if name in SECTIONS else flat
    gone = {key for key in flat.keys() & _ALL if key not in known} | {"engine"}
    if flat.get("nonnegative") is None:
        gone.add("nonnegative")
    names = ", ".join(sorted(gone))
    log.info("reconstruction of version 0.1: left out %s (not used by %s)", names, name)
    valid = {key: value for key, value in flat.items() if key not in gone}
    return data | {"reconstruction": valid | {"algorithm": name}}


def _without_former(section: dict[str, Any]) -> dict[str, Any]:
    """Return a reconstruction without keys that its algorithm no longer has."""
    name = section.get("algorithm")
    if name not in _FORMER or not section.keys() >= _FORMER[name]:
        return section
    gone = _FORMER[name] | (_LATER[name] & section.keys())
    log.info("reconstruction by an earlier %s: left out %s", name, ", ".join(sorted(gone)))
    kept = {key: value for key, value in section.items() if key not in gone}
    if name == "fast":
        if kept.get("passes", 0) is None:
            del kept["passes"]
        return kept
    allowed = section["nonnegative"] is False
    return kept | {"strength": section["regularisation"], "allow_negative": allowed}


def volume_digest(scan_digest: str, section: dict[str, Any]) -> str:
    """Return version 0.1's digest of a volume: SHA-256 of its scan's digest and settings as JSON.

    Args:
        scan_digest: digest in the scan store.
        section: ``reconstruction`` as version 0.1 stored it.
    """
    text = json.dumps(_in_order(section), separators=(",", ":"), ensure_ascii=False)
    return hashlib.sha256((scan_digest + text).encode()).hexdigest()


def _in_order(value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    section = cast("dict[str, Any]", value)
    places = {key: place for place, key in enumerate(_ORDER)}
    ordered = sorted(section, key=lambda key: places.get(key, len(_ORDER)))
    return {key: _in_order(section[key]) for key in ordered}
