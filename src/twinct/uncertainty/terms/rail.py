"""Crooked rails: the carriage leaves its straight way, and tilts, by waves along it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from twinct.geometry import MM_PER_M
from twinct.uncertainty.error_terms import ErrorTerm, Spread, ToolMotion
from twinct.uncertainty.sections import ArmErrors
from twinct.uncertainty.terms.displacements import twist_sigmas


def _spreads(section: ArmErrors, motion: ToolMotion) -> Iterator[Spread]:
    chain = motion.chain
    if chain is None or not chain.rails:
        return
    carried = [rail + 1 for rail in chain.rails]  # the joint that stands on the carriage
    turns = 2 * np.pi * MM_PER_M / section.rail_period_mm * motion.joints[:, list(chain.rails)]
    # Cosine and sine of independent amplitudes: equal spread at all places of the carriage.
    for wave in (np.cos(turns), np.sin(turns)):
        sigma = np.zeros((len(turns), len(chain), 6))
        sigma[:, carried] = wave[..., None] * twist_sigmas(section.rail_mm, section.rail_deg)
        yield Spread("links", sigma)


RAIL = ErrorTerm("rail", ArmErrors, _spreads, ("links",), "arms")
