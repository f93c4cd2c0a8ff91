"""Late images: the arms move on between the encoders' reading and the image."""

from __future__ import annotations

from collections.abc import Iterator

from twinct.geometry import Misfit
from twinct.uncertainty.error_terms import ArmShift, ErrorTerm, Spread, ToolMotion, ViewDraws
from twinct.uncertainty.sections import ArmErrors

S_PER_MS = 1e-3


def _spreads(section: ArmErrors, motion: ToolMotion) -> Iterator[Spread]:
    if motion.chain is not None:
        jitter = section.trigger_jitter_ms * S_PER_MS * motion.speeds
        yield Spread("joints", jitter, length=0.0, draws="all")
        delay = section.trigger_delay_ms * S_PER_MS * motion.speeds
        yield Spread("joints", delay, draws="none")


def _drawn(section: ArmErrors, chain: object, draws: object) -> ArmShift:
    def misfit(motion: ToolMotion, of_views: ViewDraws) -> Misfit:
        late_ms = section.trigger_delay_ms
        jitter = of_views("trigger", 1, 0.0)
        if jitter is not None:
            late_ms = late_ms + section.trigger_jitter_ms * jitter
        return Misfit(joints=(late_ms * S_PER_MS * motion.speeds,))

    return misfit


TRIGGER = ErrorTerm("trigger", ArmErrors, _spreads, ("joints",), "arms", _drawn)
