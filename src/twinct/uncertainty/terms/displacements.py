"""Displaced frames: zeros of the joints, links, bases, tools, and ageing of the calibration."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from twinct.core.error_terms import ErrorTerm, Place, Spread, ToolMotion
from twinct.geometry import Floats
from twinct.scenario import ArmErrors


def twist_sigmas(mm: float, deg: float) -> Floats:
    """Return the standard deviations of a twist (v, w), equal for all axes, (6,), mm and rad."""
    return np.array([mm] * 3 + [np.radians(deg)] * 3)


def _term(name: str, place: Place, sigma: Callable[[ArmErrors], Floats]) -> ErrorTerm:
    def spreads(section: ArmErrors, motion: ToolMotion) -> Iterator[Spread]:
        if motion.chain is not None:
            yield Spread(place, sigma(section))

    return ErrorTerm(name, ArmErrors, spreads, section="arms")


def _aged(section: ArmErrors, motion: ToolMotion) -> Iterator[Spread]:
    if motion.chain is not None:
        aged = twist_sigmas(section.ageing_mm, section.ageing_deg) * np.sqrt(section.age_months)
        yield Spread("base", aged)
        yield Spread("tool", aged)


JOINT_OFFSET = _term(
    "joint offset",
    "links",
    lambda arms: twist_sigmas(0, arms.joint_offset_deg) * (0, 0, 0, 0, 0, 1),
)
LINK = _term(
    "link", "links", lambda arms: twist_sigmas(arms.link_mm, arms.link_deg) * (1, 1, 1, 1, 1, 0)
)
BASE = _term("base", "base", lambda arms: twist_sigmas(arms.base_mm, arms.base_deg))
TOOL = _term("tool", "tool", lambda arms: twist_sigmas(arms.tool_mm, arms.tool_deg))
AGEING = ErrorTerm("ageing", ArmErrors, _aged, section="arms")
