"""Deflection of the joints behind their encoders, under the weight of links and tool."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from twinct.geometry import Chain, Floats, Misfit
from twinct.uncertainty.error_terms import ArmShift, ErrorTerm, ScanDraws, Spread, ToolMotion
from twinct.uncertainty.sections import ArmErrors


def mean_compliance(section: ArmErrors, chain: Chain) -> Floats:
    """Return the mean compliance of each joint behind its encoder, (joints,), rad/(N m).

    A rail has none.
    """
    return np.radians(section.windup_deg) * chain.hinges / chain.torque_limits


def deflections(compliance: Floats, chain: Chain, joints: Floats) -> Floats:
    """Return the deflection of each joint under gravity, (..., views, joints), rad.

    Args:
        compliance: (..., joints), rad/(N m).
        chain: nominal arm.
        joints: (views, joints), rad.
    """
    return compliance[..., None, :] * chain.gravity_torques(joints)


def compliances(section: ArmErrors, chain: Chain, draws: ScanDraws) -> Floats:
    """Draw the compliance of each joint behind its encoder, (draws, joints), rad/(N m)."""
    spread = section.windup_spread * draws.rng("windup").normal(size=(draws.count, len(chain)))
    return mean_compliance(section, chain) * (1 + spread)


def _spreads(section: ArmErrors, motion: ToolMotion) -> Iterator[Spread]:
    if motion.chain is not None:
        torques = motion.chain.gravity_torques(motion.joints)
        mean = mean_compliance(section, motion.chain)
        yield Spread("joints", section.windup_spread * mean * torques)
        yield Spread("joints", mean * torques, draws="none")


def _drawn(section: ArmErrors, chain: Chain, draws: ScanDraws) -> ArmShift:
    own = compliances(section, chain, draws)
    return lambda motion, _: Misfit(joints=(deflections(own, chain, motion.joints),))


WINDUP = ErrorTerm(
    "windup", ArmErrors, _spreads, ("joints",), "arms", _drawn, prior=lambda section: {}
)
