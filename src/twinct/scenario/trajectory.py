"""Where source and panel shall go."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from twinct.settings import (
    Conflict,
    ConflictError,
    Finite,
    Positive,
    Section,
    Vector,
    facts,
)


class _Orbit(Section):
    views: int = Field(ge=1, le=100_000, description="Number of projections.")
    isocentre_mm: Vector = Field(default=(0.0, 0.0, 0.0), description="Centre of the orbit.")
    sod_mm: Positive = Field(
        default=300.0,
        description="Distance from source to isocentre.",
        json_schema_extra=facts(source="the paper"),
    )
    sdd_mm: Positive = Field(
        default=600.0,
        description="Distance from source to panel centre.",
        json_schema_extra=facts(source="the paper, as docs/paper.md reads it"),
    )
    centre_longitude_deg: Finite = Field(
        default=0.0,
        description="Longitude of the source in the middle of the path; 0 is +x, 90 is +y.",
    )

    @model_validator(mode="after")
    def _isocentre_between(self) -> _Orbit:
        if self.sdd_mm <= self.sod_mm:
            message = (
                f"sdd_mm ({self.sdd_mm:g}) must exceed sod_mm ({self.sod_mm:g}): "
                "the isocentre lies between source and panel"
            )
            raise ConflictError(Conflict(message, ("sdd_mm", "sod_mm")))
        return self


class SinusoidTrajectory(_Orbit):
    """The paper's path: a sine of latitude over an arc of longitude, on a sphere."""

    kind: Literal["sinusoid"]
    longitude_range_deg: float = Field(
        default=210.0,
        gt=0,
        le=360,
        description="Arc of longitude.",
        json_schema_extra=facts(source="the paper: 180 degrees and the fan"),
    )
    latitude_amplitude_deg: float = Field(
        default=30.0,
        ge=0,
        lt=90,
        description="Amplitude of the sine of latitude.",
        json_schema_extra=facts(source="the paper"),
    )
    periods: Positive = Field(
        default=1.0,
        description="Sine periods over the range.",
        json_schema_extra=facts(source="the paper, as docs/paper.md reads it"),
    )


class CircleTrajectory(_Orbit):
    """A full circle; the first and last view are one step apart."""

    kind: Literal["circle"]
    tilt_deg: Finite = Field(default=0.0, description="Tilt of the circle about the x axis.")


class ArcTrajectory(_Orbit):
    """Part of a circle of constant latitude, both ends included."""

    kind: Literal["arc"]
    longitude_range_deg: float = Field(
        default=210.0,
        gt=0,
        le=360,
        description="Arc of longitude.",
        json_schema_extra=facts(source="180 degrees and the paper's fan"),
    )
    latitude_deg: float = Field(
        default=0.0, gt=-90, lt=90, description="Latitude of the source; 90 is +z."
    )


class HelixTrajectory(_Orbit):
    """A helix about z: source and panel rise together."""

    kind: Literal["helix"]
    turns: Positive = Field(default=2.0, description="Turns about z.")
    pitch_mm: Finite = Field(default=50.0, description="Rise for each turn.")


class FileTrajectory(Section):
    """Views from a CSV file: S and D, or S, D, u, v for each row, mm."""

    kind: Literal["file"]
    path: Path = Field(description="CSV file.")


Trajectory = Annotated[
    SinusoidTrajectory | CircleTrajectory | ArcTrajectory | HelixTrajectory | FileTrajectory,
    Field(discriminator="kind"),
]
