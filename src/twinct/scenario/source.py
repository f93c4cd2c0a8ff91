"""X-ray source. Every default is ideal."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from twinct.scenario.composition import Composition
from twinct.settings import Conflict, ConflictError, Length, Pair, Positive, Section, facts, setting

MOST_KV = 50.0
"""Highest tube voltage that SpekPy supports for molybdenum and rhodium."""


class Filter(Section):
    """Plate in the beam, crossed at right angles."""

    material: str | Composition = setting(
        "aluminium", "Material of the plate.", source="attenuation: xraylib"
    )
    thickness_mm: Length = Field(description="Its thickness.")


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
        12.0, "Between anode face and central ray.", gt=0, le=90, source="SpekPy's default"
    )
    target: Literal["W", "Mo", "Rh"] = setting("W", "Element of the anode.", source="SpekPy")
    filters: tuple[Filter, ...] = setting(
        (Filter(thickness_mm=2.5),),
        "Plates between anode and specimen.",
        source="2.5 mm Al: the least total filtration of IEC 60601-1-3",
    )
    bins: int = setting(60, "Energy bins at most.", ge=1, le=1000)

    @model_validator(mode="after")
    def _range_of_the_target(self) -> TubeSpectrum:
        if self.target != "W" and self.kvp > MOST_KV:
            message = (
                f"kvp ({self.kvp:g}) must be at most {MOST_KV:g} with target {self.target}: SpekPy "
                "knows no more of it"
            )
            raise ConflictError(Conflict(message, ("kvp", "target")))
        return self


class FileSpectrum(Section):
    """A tabulated spectrum."""

    kind: Literal["file"]
    path: Path = Field(
        description="Two columns: energy in keV (rising, 0.1 to 800), photons of that bin."
    )
    filters: tuple[Filter, ...] = setting((), "Plates between this spectrum and the specimen.")
    bins: int = setting(60, "Energy bins at most.", ge=1, le=1000)


Spectrum = Annotated[TubeSpectrum | FileSpectrum, Field(discriminator="kind")]


class _Spot(Section):
    samples: int = setting(24, "Points of the spot; an image costs as many renders.", ge=1, le=1000)


class GaussianSpot(_Spot):
    """A focal spot of Gaussian intensity."""

    kind: Literal["gaussian"]
    sigma_mm: Length | Pair = Field(
        description="Standard deviation; two numbers for (x, y). 4 sigma are at most a quarter of "
        "the distance to the panel."
    )


class SquareSpot(_Spot):
    """A rectangle of constant intensity."""

    kind: Literal["square"]
    size_mm: Length | Pair = Field(
        description="Edge; two numbers for (x, y). At most a quarter of the distance to the panel."
    )


class ImageSpot(_Spot):
    """Measured focal spot."""

    kind: Literal["image"]
    path: Path = Field(description="Intensity as .npy, or an image; row 0 at the lowest y.")
    size_mm: Length | Pair = Field(
        description="Edge of the image; two numbers for (x, y). At most a quarter of the distance "
        "to the panel."
    )


Spot = Annotated[GaussianSpot | SquareSpot | ImageSpot, Field(discriminator="kind")]


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
        "A tube, or a file; monochromatic where there is none.",
        source="one energy: the paper",
    )
    photons_per_mm2_mas: Positive | None = setting(
        None,
        "Photons of the free beam per mm^2 at 1 m and mAs, behind the filters. A tube "
        "knows its own number; noise of any other source needs this one.",
        unit="1/(mm^2 mAs)",
        source="a tube's: SpekPy",
    )
    current_ma: Positive = setting(1.0, "Tube current.")
    exposure_ms: float = setting(
        10.0,
        "How long the shutter is open. With motion_samples above 1 the arms are "
        "simulated for as long in every view.",
        gt=0,
        le=60_000,
    )
    motion_samples: int = setting(
        1,
        "Instants of the exposure, at equal distances, whose mean the image is: motion "
        "blur. 1: all stands as when the image was triggered. An image costs as many renders.",
        ge=1,
        le=1000,
        source="1, no blur: the paper",
    )
    focal_spot: Spot | None = setting(
        None, "A point where there is none.", source="a point: the paper"
    )

    @property
    def mas(self) -> float:
        """Tube load of one view, mAs."""
        return self.current_ma * self.exposure_ms / 1000.0

    @property
    def ideal(self) -> bool:
        """True for a monochromatic point source."""
        return self.spectrum is None and self.focal_spot is None
