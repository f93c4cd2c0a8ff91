"""What separates the believed poses from the executed ones."""

from __future__ import annotations

from pydantic import Field

from twinct.settings import NonNegative, Positive, Section, facts


class PositionNoise(Section):
    """Normal noise for each axis, redrawn beyond the cut-off."""

    sigma_mm: NonNegative = Field(
        default=0.1,
        description="Standard deviation for each axis.",
        json_schema_extra=facts(source="the paper"),
    )
    cutoff_mm: Positive = Field(
        default=0.15,
        description="Largest deviation on each axis.",
        json_schema_extra=facts(source="the paper: repeatability"),
    )


class Uncertainty(Section):
    """What separates the believed poses from the executed ones."""

    source: PositionNoise = Field(
        default=PositionNoise(),
        description="Of the source's position.",
        json_schema_extra=facts(source="the paper"),
    )
    detector: PositionNoise = Field(
        default=PositionNoise(),
        description="Of the panel's position.",
        json_schema_extra=facts(source="the paper"),
    )
    seed: int | None = Field(
        default=None,
        ge=0,
        lt=2**63,
        description="Of this noise alone; the scenario's where null. Other seeds here are other "
        "believed poses of the same images.",
    )
