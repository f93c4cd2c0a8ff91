"""Sections of a patient's motion: breathing by a simple model, or by fields of the user's own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from twinct.core.settings import (
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
