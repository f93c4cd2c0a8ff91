"""Displaced frames: zeros of the joints, links, bases, tools, and ageing of the calibration."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from twinct.geometry import Chain, Floats, Misfit
from twinct.uncertainty.error_terms import (
    ArmShift,
    ErrorTerm,
    Place,
    ScanDraws,
    Spread,
    ToolMotion,
)
from twinct.uncertainty.sections import ArmErrors


def twist_sigmas(mm: float, deg: float) -> Floats:
    """Return the standard deviations of a twist (v, w), equal for all axes, (6,), mm and rad."""
    return np.array([mm] * 3 + [np.radians(deg)] * 3)


def _term(
    name: str,
    sigmas: Callable[[ArmErrors], dict[Place, Floats]],
    *places: Place,
    of_hinges: bool = False,
) -> ErrorTerm:
    def of(section: ArmErrors, chain: Chain) -> Iterator[tuple[Place, Floats]]:
        for place, sigma in sigmas(section).items():
            yield place, chain.hinges[:, None] * sigma if of_hinges and chain.rails else sigma

    def spreads(section: ArmErrors, motion: ToolMotion) -> Iterator[Spread]:
        if motion.chain is not None:
            for place, sigma in of(section, motion.chain):
                yield Spread(place, sigma)

    def drawn(section: ArmErrors, chain: Chain, draws: ScanDraws) -> ArmShift:
        """Draw once what the spreads say, as it stays the same at all views."""
        parts: Any = {}
        for place, sigma in of(section, chain):
            shape = (len(chain), 6) if place == "links" else (6,)
            normals = draws.rng(f"{name} {place}").normal(size=(draws.count, *shape))
            parts[place] = sigma * normals[:, None]
        misfit = Misfit(**parts)
        return lambda motion, of_views: misfit

    return ErrorTerm(name, ArmErrors, spreads, places, "arms", drawn)


def _aged(section: ArmErrors) -> dict[Place, Floats]:
    aged = twist_sigmas(section.ageing_mm, section.ageing_deg) * np.sqrt(section.age_months)
    return {"base": aged, "tool": aged}


JOINT_OFFSET = _term(
    "joint offset",
    lambda arms: {"links": twist_sigmas(0, arms.joint_offset_deg) * (0, 0, 0, 0, 0, 1)},
    "links",
    of_hinges=True,
)
LINK = _term(
    "link",
    lambda arms: {"links": twist_sigmas(arms.link_mm, arms.link_deg) * (1, 1, 1, 1, 1, 0)},
    "links",
)
BASE = _term("base", lambda arms: {"base": twist_sigmas(arms.base_mm, arms.base_deg)}, "base")
TOOL = _term("tool", lambda arms: {"tool": twist_sigmas(arms.tool_mm, arms.tool_deg)}, "tool")
AGEING = _term("ageing", _aged, "base", "tool")
