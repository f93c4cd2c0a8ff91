"""Known motion of the patient, as the reconstruction treats it."""

from __future__ import annotations

from collections.abc import Iterator

from pydantic import model_validator

from twinct.core.settings import Conflict, Finite, NonNegative, Section, setting
from twinct.specimen.sections import Phase


class KnownMotion(Section):
    """Treatment of a patient's known motion, and the state of breathing that is reconstructed."""

    compensate: bool = setting(
        True,
        "True: each view sees the body in its state at the time of the view. False: all views see "
        "it at rest.",
    )
    amplitude_rel: NonNegative = setting(
        1.0, "Believed amplitude, relative to the executed one; 0.8 is 20 % too small.", le=10
    )
    delay_s: Finite = setting(0.0, "Time by which the believed motion lags the executed one.")
    phase: Phase = setting(
        0.0, "State of the volume, and of the truth: share of a usual breath; 0 is full exhalation."
    )
    gate: tuple[Phase, Phase] | None = setting(
        None,
        "First and last phase of the views that count, such as [0.85, 0.15], across the end of a "
        "breath; null: all.",
    )

    @model_validator(mode="after")
    def _some_phases(self) -> KnownMotion:
        if self.gate is not None and self.gate[0] == self.gate[1]:
            raise ValueError(f"gate {list(self.gate)} holds no phase: its ends must differ")
        return self


COMPENSATING = ("sart", "fast", "fista_tv", "fdk")
"""Algorithms that can compensate a known motion."""


def motion_conflicts(
    known: KnownMotion | None, *, moves: bool, algorithm: str, metal: bool, lag: bool
) -> Iterator[Conflict]:
    """Yield the conflicts of ``specimen.motion`` and ``reconstruction.motion`` with other keys.

    Args:
        known: section ``reconstruction.motion``.
        moves: whether the specimen has a motion.
        algorithm: name of the algorithm.
        metal: whether metal is corrected.
        lag: whether the detector's signal lags.
    """
    if moves and lag:
        yield Conflict(
            "detector.lag: the signal of the previous view cannot be used with specimen.motion",
            ("detector.lag", "specimen.motion"),
        )
    if known is None:
        return
    if not moves:
        yield Conflict(
            "reconstruction.motion needs a motion of the patient, specimen.motion",
            ("reconstruction.motion", "specimen.motion"),
        )
    if known.compensate and algorithm not in COMPENSATING:
        yield Conflict(
            f"reconstruction.motion: {algorithm} cannot compensate a motion; "
            f"{', '.join(COMPENSATING)} can, and compensate: false ignores it",
            ("reconstruction.motion", "reconstruction.algorithm"),
        )
    if known.compensate and metal:
        yield Conflict(
            "reconstruction.metal cannot be combined with a compensated motion",
            ("reconstruction.motion", "reconstruction.metal"),
        )
