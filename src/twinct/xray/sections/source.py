"""X-ray source. Every default is ideal."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from twinct.core.settings import (
    Conflict,
    ConflictError,
    Length,
    NonNegative,
    Pair,
    Positive,
    Section,
    facts,
    setting,
)
from twinct.specimen.sections.composition import Composition

MOST_KV = 50.0
"""Highest tube voltage that SpekPy supports for molybdenum and rhodium."""


class Filter(Section):
    """Plate in the beam, crossed at right angles."""

    material: str | Composition = setting(
        "aluminium", "Material of the plate.", source="attenuation: xraylib"
    )
    thickness_mm: Length = Field(description="Thickness of the plate.")


class TubeSpectrum(Section):
    """Spectrum of an X-ray tube, computed by SpekPy."""

    kind: Literal["tube"]
    kvp: float = Field(
        ge=20,
        le=300,
        description="Tube voltage: up to 300 kV for W, up to 50 kV for Mo and Rh.",
        json_schema_extra=facts(source="SpekPy (Poludniowski et al., Med. Phys. 48 (2021) 3630)"),
    )
    anode_angle_deg: float = setting(
        12.0, "Angle between anode face and central ray.", gt=0, le=90, source="SpekPy's default"
    )
    target: Literal["W", "Mo", "Rh"] = setting("W", "Element of the anode.", source="SpekPy")
    filters: tuple[Filter, ...] = setting(
        (Filter(thickness_mm=2.5),),
        "Plates between anode and specimen.",
        source="2.5 mm Al: the smallest total filtration of IEC 60601-1-3",
    )
    bins: int = setting(60, "Largest number of energy bins.", ge=1, le=1000)
    anode_side: Literal["+u", "-u", "+v", "-v"] | None = setting(
        None,
        "Direction on the panel in which the anode lies: fewer and harder photons go there (heel "
        "effect); null: one spectrum on the whole panel.",
        source="SpekPy, off the central ray",
    )

    @model_validator(mode="after")
    def _range_of_the_target(self) -> TubeSpectrum:
        if self.target != "W" and self.kvp > MOST_KV:
            message = (
                f"kvp ({self.kvp:g}) must be at most {MOST_KV:g} with target {self.target}: "
                "SpekPy supports no higher voltage"
            )
            raise ConflictError(Conflict(message, ("kvp", "target")))
        return self


class FileSpectrum(Section):
    """A tabulated spectrum."""

    kind: Literal["file"]
    path: Path = Field(
        description="Two columns: energy in keV (rising, 0.1 to 800), photons in the bin around it."
    )
    filters: tuple[Filter, ...] = setting((), "Plates between this spectrum and the specimen.")
    bins: int = setting(60, "Largest number of energy bins.", ge=1, le=1000)


Spectrum = Annotated[TubeSpectrum | FileSpectrum, Field(discriminator="kind")]


class _Spot(Section):
    samples: int = setting(
        24, "Points that sample the spot; an image is rendered for each point.", ge=1, le=1000
    )


class GaussianSpot(_Spot):
    """A focal spot of Gaussian intensity."""

    kind: Literal["gaussian"]
    sigma_mm: Length | Pair = Field(
        description="Standard deviation; two numbers for (x, y). 4 sigma must be at most a "
        "quarter of the distance to the panel."
    )


class SquareSpot(_Spot):
    """A rectangle of constant intensity."""

    kind: Literal["square"]
    size_mm: Length | Pair = Field(
        description="Edge; two numbers for (x, y); at most a quarter of the distance to the panel."
    )


class ImageSpot(_Spot):
    """Measured focal spot."""

    kind: Literal["image"]
    path: Path = Field(
        description="Intensity as a .npy file or an image; row 0 is at the lowest y."
    )
    size_mm: Length | Pair = Field(
        description="Edge of the image; two numbers for (x, y); at most a quarter of the "
        "distance to the panel."
    )


Spot = Annotated[GaussianSpot | SquareSpot | ImageSpot, Field(discriminator="kind")]


class BowtieFilter(Section):
    """Filter at the source, thicker towards the edges of the fan; it moves with the source."""

    along: Literal["u", "v"] = Field(
        description="Axis of the panel along which the fan opens and the thickness changes."
    )
    material: str | Composition = setting("aluminium", "Material of the filter.")
    angles_deg: tuple[NonNegative, ...] = Field(
        min_length=2,
        description="Angles to the central ray in the fan, rising from 0; the filter is symmetric.",
    )
    thickness_mm: tuple[NonNegative, ...] = Field(
        min_length=2,
        description="Path of the ray at each angle; linear between them, constant beyond the last.",
    )

    @model_validator(mode="after")
    def _one_thickness_an_angle(self) -> BowtieFilter:
        angles, keys = self.angles_deg, ("angles_deg", "thickness_mm")
        problem = ""
        if len(angles) != len(self.thickness_mm):
            problem = f"{len(angles)} angles for {len(self.thickness_mm)} thicknesses"
        elif angles[0] != 0 or any(b <= a for a, b in zip(angles, angles[1:], strict=False)):
            problem = f"the angles must rise from 0, but are {', '.join(f'{a:g}' for a in angles)}"
        elif angles[-1] >= 90:
            problem = f"an angle of {angles[-1]:g} deg: must be below 90"
        if problem:
            raise ConflictError(Conflict(problem, keys))
        return self


class Source(Section):
    """X-ray source; a monochromatic point by default."""

    energy_kev: float = setting(
        80.0,
        "Photon energy of the monochromatic source; not used with a spectrum.",
        ge=5,
        le=500,
        source="the paper",
    )
    spectrum: Spectrum | None = setting(
        None,
        "Spectrum of a tube, or from a file; null: monochromatic.",
        source="monochromatic: the paper",
    )
    photons_per_mm2_mas: Positive | None = setting(
        None,
        "Photons of the free beam per mm^2 and mAs at 1 m, behind the filters. A tube "
        "determines its own number; noise with any other source needs this key.",
        unit="1/(mm^2 mAs)",
        source="for a tube: SpekPy",
    )
    current_ma: Positive = setting(1.0, "Tube current.")
    exposure_ms: float = setting(
        10.0,
        "Time for which the shutter is open. With motion_samples above 1, the arms are "
        "simulated for this time in every view.",
        gt=0,
        le=60_000,
        read_by="executed",
    )
    motion_samples: int = setting(
        1,
        "Number of equally spaced instants of the exposure; the image is their mean, which "
        "shows motion blur. 1: everything stands still where it is at the trigger. An image is "
        "rendered for each instant.",
        ge=1,
        le=1000,
        source="1, no blur: the paper",
        read_by="executed",
    )
    focal_spot: Spot | None = setting(
        None, "Focal spot; null: a point.", source="a point: the paper"
    )

    bowtie: BowtieFilter | None = setting(None, "Bowtie filter at the source; null: none.")

    @property
    def mas(self) -> float:
        """Tube load of one view, mAs."""
        return self.current_ma * self.exposure_ms / 1000.0

    @property
    def ideal(self) -> bool:
        """True for a monochromatic point source without a bowtie filter."""
        return self.spectrum is None and self.focal_spot is None and self.bowtie is None
