"""Streaks around a part, such as an implant."""

from __future__ import annotations

from pydantic import Field, model_validator

from twinct.core.settings import Length, NonNegative, setting
from twinct.evaluation.figure import percent
from twinct.evaluation.figure_kind import (
    FigureKind,
    FigureSettings,
    Measurement,
)
from twinct.evaluation.region_voxels import shell
from twinct.evaluation.streaks import around_axis, streak_index


class Streaks(FigureSettings):
    """Dependence of the error around a part on the direction."""

    part: str = Field(description="Name of the part, such as an implant.")
    from_mm: NonNegative = setting(2.0, "Distance from the part at which the shell begins.")
    to_mm: Length = setting(15.0, "Distance from the part at which the shell ends.")

    @model_validator(mode="after")
    def _outwards(self) -> Streaks:
        if self.to_mm <= self.from_mm:
            raise ValueError(f"to_mm ({self.to_mm:g}) must be above from_mm ({self.from_mm:g})")
        return self


def _measure(at: Measurement, one: Streaks) -> dict[str, float]:
    body = at.places.part(one.part)
    near = shell(body, at.grid, one.from_mm, one.to_mm)
    if not (len(near) and len(body)):
        return {}
    error = (near.of(at.volume) - near.of(at.truth)) / at.mu_reference
    where = around_axis(near.points(at.grid), body.points(at.grid))
    return {"streak_rel": streak_index(error, *where)}


STREAKS = FigureKind(
    "streaks",
    Streaks,
    "Parts around which streaks are measured.",
    (
        percent(
            "streak_rel",
            "streaks",
            "of μ({0}), error from sector to sector",
            "lower",
            good="below 1 %",
            without_signal="null",
            blind_to=("blur", "smoothing"),
        ),
    ),
    _measure,
    names={"part": "part"},
)
