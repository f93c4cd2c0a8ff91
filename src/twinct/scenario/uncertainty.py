"""What separates the believed poses from the executed ones."""

from __future__ import annotations

from twinct.settings import NonNegative, Positive, Section, setting


class PositionNoise(Section):
    """Normal noise for each axis, redrawn beyond the cut-off."""

    sigma_mm: NonNegative = setting(0.1, "Standard deviation for each axis.", source="the paper")
    cutoff_mm: Positive = setting(
        0.15, "Largest deviation on each axis.", source="the paper: repeatability"
    )


class Uncertainty(Section):
    """What separates the believed poses from the executed ones."""

    source: PositionNoise = setting(
        PositionNoise(), "Of the source's position.", source="the paper"
    )
    detector: PositionNoise = setting(
        PositionNoise(), "Of the panel's position.", source="the paper"
    )
    seed: int | None = setting(
        None,
        "Of this noise alone; the scenario's where null. Other seeds here are other "
        "believed poses of the same images.",
        ge=0,
        lt=2**63,
    )
