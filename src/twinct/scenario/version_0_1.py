"""Scenarios as version 0.1 wrote them into its results: one flat section for all algorithms.

The section then held every key with its default, ``engine`` and those without effect included; no
person writes all of them, so that they are known by it.
"""

from __future__ import annotations

import logging
from typing import Any, cast

from twinct.scenario.reconstruction import SECTIONS

log = logging.getLogger(__name__)

_ALL = {
    *("algorithm", "engine", "iterations", "relaxation", "order", "subsets", "regularisation"),
    *("weighting", "tv_steps", "window", "nonnegative"),
    *("surroundings", "beam_hardening", "geometry", "grid"),
}


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


def advice(key: tuple[str | int, ...], value: Any) -> str:
    """What to do with a key that version 0.1 had and that is gone."""
    if key != ("reconstruction", "engine"):
        return ""
    instead = "use algorithm: rtk_sart" if value == "rtk" else "leave it out"
    return f"there is no such key any more: {instead}"
