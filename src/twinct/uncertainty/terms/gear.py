"""Eccentric gears: a sine of the joint angle, with a random phase."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from twinct.geometry import Chain, Floats, Misfit
from twinct.uncertainty.error_terms import ArmShift, ErrorTerm, ScanDraws, Spread, ToolMotion
from twinct.uncertainty.sections import ArmErrors


def waves(amplitudes: Floats, periods: int, joints: Floats) -> tuple[Floats, Floats]:
    """Return cosine and sine part of each joint's gear error, (..., views, joints), rad.

    Args:
        amplitudes: of cosine and sine, (..., joints, 2), rad.
        periods: periods of the error in one turn of a joint.
        joints: encoder readings, (views, joints), rad.
    """
    own, turns = amplitudes[..., None, :, :], periods * joints
    return own[..., 0] * np.cos(turns), own[..., 1] * np.sin(turns)


def amplitudes(section: ArmErrors, chain: Chain, draws: ScanDraws) -> Floats:
    """Draw the amplitudes of cosine and sine of each joint, (draws, joints, 2), rad."""
    phase = draws.rng("gear").uniform(0, 2 * np.pi, (draws.count, len(chain)))
    size = np.radians(section.gear_deg) * chain.hinges[:, None]
    return size * np.stack([np.sin(phase), np.cos(phase)], axis=-1)


def _spreads(section: ArmErrors, motion: ToolMotion) -> Iterator[Spread]:
    if motion.chain is not None:
        # Cosine and sine of a random phase have independent amplitudes of this variance.
        turns = section.gear_periods * motion.joints
        for wave in (np.cos(turns), np.sin(turns)):
            size = np.radians(section.gear_deg) * motion.chain.hinges
            yield Spread("joints", size / np.sqrt(2) * wave)


def _drawn(section: ArmErrors, chain: Chain, draws: ScanDraws) -> ArmShift:
    own = amplitudes(section, chain, draws)
    return lambda motion, _: Misfit(joints=waves(own, section.gear_periods, motion.joints))


GEAR = ErrorTerm("gear", ArmErrors, _spreads, ("joints",), "arms", _drawn, prior=lambda section: {})
