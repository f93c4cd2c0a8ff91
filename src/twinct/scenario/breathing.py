"""Sections of a patient's motion: breathing by a simple model, or by fields of the user's own."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from twinct.core.settings import (
    Conflict,
    Finite,
    NonNegative,
    Pair,
    Positive,
    Section,
    Vector,
    setting,
)

Phase = Annotated[float, Field(ge=0, le=1)]


class Rhythmic(Section):
    """Keys of every motion: the part that moves, and the course of its breaths over time."""

    part: str = setting(
        "", "Name of the grey part that moves; empty: the only one. All other parts stand still."
    )
    period_s: Positive = setting(4.0, "Mean length of a breath.", ge=0.2)
    start_phase: Phase = setting(
        0.0, "Share of the first breath that has passed when the scan begins."
    )
    irregularity: float = setting(
        0.0, "Standard deviation of the logarithm of a breath's length and depth.", ge=0, le=0.5
    )
    drift_per_min: Finite = setting(
        0.0, "Drift of the rest position, in depths of a usual breath per minute."
    )
    seed: int = setting(0, "Seed of the irregularity.", ge=0, lt=2**63)


class Breathing(Rhythmic):
    """Simple model of a breathing chest in the part's frame: x right, y front, z up."""

    kind: Literal["breathing"]
    diaphragm_mm: NonNegative = setting(
        15.0, "Excursion of the diaphragm's dome in a usual breath."
    )
    front_mm: NonNegative = setting(6.0, "Excursion of the chest's front wall in a usual breath.")
    hysteresis: float = setting(
        0.2, "Lead of the front wall over the diaphragm, as a share of its excursion.", ge=-1, le=1
    )
    dome_mm: Vector = setting((0.0, 10.0, -20.0), "The diaphragm's dome in the part's frame.")
    reach_mm: Pair = setting(
        (200.0, 200.0), "Lengths above and below the dome over which the excursion falls to 0."
    )
    half_axes_mm: Pair = setting((165.0, 114.0), "Half axes of the chest: across, back to front.")


class FieldFile(Section):
    """Displacement of the body in one phase."""

    path: Path = Field(
        description="NIfTI file of vectors, (x, y, z, 3) or (x, y, z, 1, 3), mm, along the axes of "
        "specimen.motion.axes: displacement of each point of the CT to its position in this phase."
    )


class Fields(Rhythmic):
    """Displacement fields of evenly spaced phases of a breath; the first one follows the last."""

    kind: Literal["fields"]
    phases: tuple[FieldFile, ...] = Field(
        min_length=2, max_length=64, description="Fields in the order of their phases, from 0."
    )
    axes: Literal["ras", "lps"] = setting(
        "ras", "Axes of the vectors. ras: right, front, up; lps, as in ITK: left, back, up."
    )


BodyMotion = Annotated[Breathing | Fields, Field(discriminator="kind")]


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
