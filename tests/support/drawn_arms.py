"""Deviations of the arms that a scenario's errors draw, as a calibration estimates them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from twinct.geometry import Chain, Floats
from twinct.scenario import Uncertainty
from twinct.uncertainty.drawn_tool import ConstantDraws, DrawnTool
from twinct.uncertainty.error_terms import ToolMotion
from twinct.uncertainty.terms.gear import amplitudes
from twinct.uncertainty.terms.registry import terms_of
from twinct.uncertainty.terms.windup import compliances


class Deviations(NamedTuple):
    """Of arms; the draws are the first axis."""

    links: Floats
    tool: Floats
    compliance: Floats
    gear: Floats


def still(chain: Chain, side: str, joints: Floats) -> ToolMotion:
    """An arm that stands still at each view."""
    none = np.zeros_like(joints)
    return ToolMotion(side, chain.tools(joints), np.zeros(len(joints)), chain, joints, none)


def deviations(
    section: Uncertainty, chain: Chain, seed: int, side: str, draws: int = 1
) -> Deviations:
    """Draw the arms of scans with a seed."""
    tool = DrawnTool(terms_of(section, side), side, chain, seed, draws)
    rest = still(chain, side, np.zeros((1, len(chain))))
    shifts, _ = tool.deviations(rest, lambda *_: None)
    links = [shift.links[:, 0] for shift in shifts if shift.links is not None]
    tools = [shift.tool[:, 0] for shift in shifts if shift.tool is not None]
    own = ConstantDraws(seed, side, draws)
    arms = section.arms
    return Deviations(
        np.sum(links, axis=0),
        np.sum(tools, axis=0),
        compliances(arms, chain, own),
        amplitudes(arms, chain, own),
    )


def true_tools(section: Uncertainty, chain: Chain, seed: int, side: str, joints: Floats) -> Floats:
    """Tools of the first of these arms, at rest, without repeatability, (views, 4, 4)."""
    tool = DrawnTool(terms_of(section, side), side, chain, seed)
    moved, _ = tool.executed(still(chain, side, joints), lambda *_: None)
    assert moved is not None
    return moved[0]
