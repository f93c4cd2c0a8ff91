"""Growth of the links that is still missing while an arm warms up."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from twinct.geometry import Chain, Floats, Misfit
from twinct.uncertainty.error_terms import ArmShift, ErrorTerm, ScanDraws, Spread, ToolMotion
from twinct.uncertainty.sections import ArmErrors

S_PER_MIN = 60.0
LENGTHS = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
"""Components of a twist that change lengths."""


def coldness(section: ArmErrors, time_s: Floats) -> Floats:
    """Return the remaining share of the warm-up at each time."""
    minutes = section.running_min + time_s / S_PER_MIN
    return np.exp(-minutes / section.warm_up_min)


def _spreads(section: ArmErrors, motion: ToolMotion) -> Iterator[Spread]:
    if motion.chain is not None:
        growth = section.drift_mm * coldness(section, motion.time_s)[:, None]
        yield Spread("links", (growth * LENGTHS)[:, None])


def _drawn(section: ArmErrors, chain: Chain, draws: ScanDraws) -> ArmShift:
    grown = section.drift_mm * draws.rng("drift").normal(size=(draws.count, len(chain), 3))

    def misfit(motion: ToolMotion, _: object) -> Misfit:
        if not section.drift_mm:
            return Misfit()
        missing = coldness(section, motion.time_s)[:, None, None] * grown[:, None]
        return Misfit(links=np.concatenate([-missing, np.zeros_like(missing)], axis=-1))

    return misfit


def _prior(section: ArmErrors) -> dict[str, Floats]:
    # During a scan, a link's missing thermal growth acts like any other error of its length.
    return {"links": section.drift_mm * LENGTHS}


DRIFT = ErrorTerm("drift", ArmErrors, _spreads, ("links",), "arms", _drawn, _prior)
