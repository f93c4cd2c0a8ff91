"""The sections of the X-ray chain: source and detector. Each default is the ideal."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from twinct.geometry import Panel
from twinct.scenario.composition import Composition
from twinct.scenario.section import (
    Conflict,
    ConflictError,
    NonNegative,
    Positive,
    Section,
    facts,
)

Pair = tuple[Positive, Positive]

MOST_KV = 50.0
"""Highest tube voltage for which SpekPy knows molybdenum and rhodium."""


class Filter(Section):
    """A plate in the beam, crossed at right angles."""

    material: str | Composition = Field(
        default="aluminium",
        description="Material of the plate.",
        json_schema_extra=facts(source="attenuation: xraylib"),
    )
    thickness_mm: Positive = Field(description="Its thickness.")


class TubeSpectrum(Section):
    """The spectrum of an X-ray tube, by SpekPy."""

    kind: Literal["tube"]
    kvp: float = Field(
        ge=20,
        le=300,
        description="Tube voltage: up to 300 kV for W, up to 50 kV for Mo and Rh.",
        json_schema_extra=facts(source="SpekPy (Poludniowski et al., Med. Phys. 48 (2021) 3630)"),
    )
    anode_angle_deg: float = Field(
        default=12.0,
        gt=0,
        le=90,
        description="Between anode face and central ray.",
        json_schema_extra=facts(source="SpekPy's default"),
    )
    target: Literal["W", "Mo", "Rh"] = Field(
        default="W", description="Element of the anode.", json_schema_extra=facts(source="SpekPy")
    )
    filters: tuple[Filter, ...] = Field(
        default=(Filter(thickness_mm=2.5),),
        description="Plates between anode and specimen.",
        json_schema_extra=facts(source="2.5 mm Al: the least total filtration of IEC 60601-1-3"),
    )
    bins: int = Field(default=60, ge=1, le=1000, description="Energy bins at most.")

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
    filters: tuple[Filter, ...] = Field(
        default=(), description="Plates between this spectrum and the specimen."
    )
    bins: int = Field(default=60, ge=1, le=1000, description="Energy bins at most.")


Spectrum = Annotated[TubeSpectrum | FileSpectrum, Field(discriminator="kind")]


class _Spot(Section):
    samples: int = Field(
        default=24, ge=1, le=1000, description="Points of the spot; an image costs as many renders."
    )


class GaussianSpot(_Spot):
    """A focal spot of Gaussian intensity."""

    kind: Literal["gaussian"]
    sigma_mm: Positive | Pair = Field(
        description="Standard deviation; two numbers for (x, y). 4 sigma are at most a quarter of "
        "the distance to the panel."
    )


class SquareSpot(_Spot):
    """A rectangle of constant intensity."""

    kind: Literal["square"]
    size_mm: Positive | Pair = Field(
        description="Edge; two numbers for (x, y). At most a quarter of the distance to the panel."
    )


class ImageSpot(_Spot):
    """A focal spot as measured."""

    kind: Literal["image"]
    path: Path = Field(description="Intensity as .npy, or an image; row 0 at the lowest y.")
    size_mm: Positive | Pair = Field(
        description="Edge of the image; two numbers for (x, y). At most a quarter of the distance "
        "to the panel."
    )


Spot = Annotated[GaussianSpot | SquareSpot | ImageSpot, Field(discriminator="kind")]


class Source(Section):
    """The X-ray source: by default a monochromatic point."""

    energy_kev: float = Field(
        default=80.0,
        ge=5,
        le=500,
        description="Photon energy of the monochromatic source; not used with a spectrum.",
        json_schema_extra=facts(source="the paper"),
    )
    spectrum: Spectrum | None = Field(
        default=None,
        description="A tube, or a file; monochromatic where there is none.",
        json_schema_extra=facts(source="one energy: the paper"),
    )
    photons_per_mm2_mas: Positive | None = Field(
        default=None,
        description="Photons of the free beam per mm^2 at 1 m and mAs, behind the filters. A tube "
        "knows its own number; noise of any other source needs this one.",
        json_schema_extra=facts(unit="1/(mm^2 mAs)", source="a tube's: SpekPy"),
    )
    current_ma: Positive = Field(default=1.0, description="Tube current.")
    exposure_ms: float = Field(
        default=10.0,
        gt=0,
        le=60_000,
        description="How long the shutter is open. With motion_samples above 1 the arms are "
        "simulated for as long in every view.",
    )
    motion_samples: int = Field(
        default=1,
        ge=1,
        le=1000,
        description="Instants of the exposure, at equal distances, whose mean the image is: motion "
        "blur. 1: all stands as when the image was triggered. An image costs as many renders.",
        json_schema_extra=facts(source="1, no blur: the paper"),
    )
    focal_spot: Spot | None = Field(
        default=None,
        description="A point where there is none.",
        json_schema_extra=facts(source="a point: the paper"),
    )

    @property
    def mas(self) -> float:
        """Tube load of one view, mAs."""
        return self.current_ma * self.exposure_ms / 1000.0

    @property
    def ideal(self) -> bool:
        """Whether it is a monochromatic point."""
        return self.spectrum is None and self.focal_spot is None


class CountingResponse(Section):
    """Ideal photon counting."""

    kind: Literal["counting"]


class IntegratingResponse(Section):
    """Ideal energy integration: every photon gives all of its energy."""

    kind: Literal["integrating"] = "integrating"


class ScintillatorResponse(Section):
    """A scintillator: what it attenuates it absorbs, with all of the photon's energy."""

    kind: Literal["scintillator"]
    material: Literal["CsI", "Gd2O2S"] | Composition = Field(
        default="CsI",
        description="Scintillator. CsI has 4.51, Gd2O2S 7.32 g/cm^3.",
        json_schema_extra=facts(source="attenuation: xraylib"),
    )
    thickness_mm: Positive = Field(
        description="Its thickness: the share 1 - exp(-mu t) of the photons is absorbed.",
        json_schema_extra=facts(source="Beer-Lambert"),
    )


class FileResponse(Section):
    """A measured quantum efficiency."""

    kind: Literal["file"]
    path: Path = Field(
        description="Two columns: energy in keV (rising), share of photons absorbed (0 to 1). At "
        "most 0.1 % of the source's photons may lie outside its energies."
    )


Response = Annotated[
    CountingResponse | IntegratingResponse | ScintillatorResponse | FileResponse,
    Field(discriminator="kind"),
]


class GaussianSpread(Section):
    """A Gaussian point spread."""

    kind: Literal["gaussian"]
    sigma_mm: Positive = Field(
        description="Standard deviation: the basic spatial resolution of ISO 19232-5 over 1.41.",
        json_schema_extra=facts(source="ISO 19232-5"),
    )


class FileSpread(Section):
    """A measured modulation transfer function."""

    kind: Literal["mtf"]
    path: Path = Field(
        description="Two columns: spatial frequency in 1/mm (rising from 0), modulation (1 at 0; 0 "
        "to 1.05). Linear between, 0 beyond the last row, which is at the Nyquist frequency of the "
        "physical pixels or above, or has a modulation of at most 0.1."
    )


PointSpread = Annotated[GaussianSpread | FileSpread, Field(discriminator="kind")]


class QuantumNoise(Section):
    """Poisson noise of the photons that the detector absorbs."""

    kind: Literal["quantum"]


class SnrNoise(Section):
    """Normal noise of a given signal-to-noise ratio; it grows with the root of the signal."""

    kind: Literal["snr"]
    snr: Positive = Field(
        description="In the free beam, at the middle of the first view's panel.",
        json_schema_extra=facts(source="as in CTSimU files"),
    )


Noise = Annotated[QuantumNoise | SnrNoise, Field(discriminator="kind")]


class Readout(Section):
    """Amplifier and converter. Without this section a pixel keeps fractions."""

    free_beam: Positive = Field(
        default=50000.0,
        description="Grey value of the free beam, above the offset, at the middle of the first "
        "view's panel: it sets the gain.",
        json_schema_extra=facts(unit="grey values"),
    )
    offset: NonNegative = Field(
        default=500.0,
        description="Grey value without beam.",
        json_schema_extra=facts(unit="grey values"),
    )
    electronic_noise: NonNegative = Field(
        default=0.0,
        description="Standard deviation of the noise without beam.",
        json_schema_extra=facts(unit="grey values"),
    )
    bits: int | None = Field(
        default=16,
        ge=1,
        le=32,
        description="Bit depth; null keeps fractions.",
        json_schema_extra=facts(unit="bit"),
    )
    saturation: Positive | None = Field(
        default=None,
        description="Grey value of saturation; the converter's largest where null. The free beam "
        "stays below it: offset + free_beam.",
        json_schema_extra=facts(unit="grey values"),
    )

    @property
    def largest(self) -> float:
        """The largest grey value there is."""
        ends = (None if self.bits is None else 2.0**self.bits - 1, self.saturation)
        return min((end for end in ends if end is not None), default=math.inf)

    @model_validator(mode="after")
    def _free_beam_fits(self) -> Readout:
        beam = self.offset + self.free_beam
        if beam <= self.largest:
            return self
        end = (
            f"saturation ({self.largest:g})"
            if self.largest == self.saturation
            else f"the largest value of {self.bits} bits ({self.largest:g})"
        )
        keys = ("free_beam", "offset", "saturation", "bits")
        if self.offset >= self.largest:
            message = f"offset ({self.offset:g}) must be below {end}: no signal could be read"
        else:
            message = (
                f"the free beam saturates: offset ({self.offset:g}) + free_beam "
                f"({self.free_beam:g}) = {beam:g} exceeds {end}"
            )
        raise ConflictError(Conflict(message, keys))


class RandomBadPixels(Section):
    """Dead pixels at places drawn from the scenario's seed."""

    kind: Literal["random"]
    share: float = Field(gt=0, lt=0.5, description="Of all pixels.")


class FileBadPixels(Section):
    """Dead pixels from a map."""

    kind: Literal["file"]
    path: Path = Field(description=".npy or image of the panel's shape; a bad pixel is not zero.")


BadPixels = Annotated[RandomBadPixels | FileBadPixels, Field(discriminator="kind")]


class Correction(Section):
    """Flat and dark images, taken without specimen before the scan."""

    flat_frames: int = Field(
        default=0, ge=0, description="Flat frames averaged; 0 for a flat image without noise."
    )
    dark_frames: int = Field(
        default=0, ge=0, description="Dark frames averaged; 0 for a dark image without noise."
    )
    flat_geometry: Literal["view", "first"] = Field(
        default="view",
        description="view: as if a flat image had been taken where each view was; first: one set "
        "at the first commanded view, so that distance and tilt of later views stay in the image.",
    )


class OneMaterialHardening(Section):
    """Beam hardening of one material, undone by a table of the known spectrum."""

    kind: Literal["one_material"]
    material: str | Composition | None = Field(
        default=None,
        description="What is linearised; null: the specimen's part with the largest volume.",
        json_schema_extra=facts(source="attenuation: xraylib"),
    )


class TwoMaterialHardening(Section):
    """Beam hardening of two materials; the dense one is segmented in a first volume."""

    kind: Literal["two_materials"]
    base: str | Composition = Field(
        default="soft_tissue",
        description="Material of everything that is not dense.",
        json_schema_extra=facts(
            source="Joseph and Spital, J. Comput. Assist. Tomogr. 2 (1978) 100"
        ),
    )
    dense: str | Composition = Field(
        default="bone",
        description="Material that is segmented; it attenuates more than base.",
        json_schema_extra=facts(source="the same"),
    )
    first_iterations: int = Field(
        default=3, ge=1, description="SART iterations of the volume that is segmented."
    )

    @model_validator(mode="after")
    def _two(self) -> TwoMaterialHardening:
        if self.base == self.dense:
            message = f"base and dense are the same material, {self.base!r}: use one_material"
            raise ConflictError(Conflict(message, ("base", "dense")))
        return self


BeamHardening = Annotated[OneMaterialHardening | TwoMaterialHardening, Field(discriminator="kind")]


class Scatter(Section):
    """Scattered radiation, a forward-scatter estimate; ``twinct.xray.scatter`` says how valid."""

    kind: Literal["kernel"]
    scale: NonNegative = Field(
        default=1.0,
        description="Factor: above 1 for scatter of higher order, below 1 for a grid.",
        json_schema_extra=facts(
            source="kernel: Ohnesorge et al., Eur. Radiol. 9 (1999) 563, and Klein-Nishina"
        ),
    )


class Detector(Section):
    """The flat panel: by default a lattice of ideal pixels."""

    columns: int = Field(
        default=640,
        ge=1,
        le=8192,
        description="Pixels along u.",
        json_schema_extra=facts(unit="px", source="the paper"),
    )
    rows: int = Field(
        default=480,
        ge=1,
        le=8192,
        description="Pixels along v.",
        json_schema_extra=facts(unit="px", source="the paper"),
    )
    pixel_pitch_mm: Positive | Pair = Field(
        default=0.5,
        description="Pixel pitch; two numbers for (u, v).",
        json_schema_extra=facts(source="the paper"),
    )
    response: Response = Field(
        default=IntegratingResponse(), description="What the detector makes of a photon."
    )
    pixel_samples: int = Field(
        default=1,
        ge=1,
        le=16,
        description="Samples along each edge of a pixel; its value is their mean. The cost grows "
        "with their square.",
        json_schema_extra=facts(source="1: the paper's gVXR"),
    )
    binning: Annotated[int, Field(ge=1, le=8)] = Field(
        default=1,
        description="Physical pixels along each edge of an image pixel; noise and spread happen in "
        "the physical ones.",
    )
    point_spread: PointSpread | None = Field(
        default=None,
        description="Spread of the signal.",
        json_schema_extra=facts(source="none: the paper"),
    )
    noise: Noise | None = Field(
        default=None,
        description="Noise of the signal.",
        json_schema_extra=facts(source="none: the paper"),
    )
    readout: Readout | None = Field(default=None, description="Grey values.")
    bad_pixels: BadPixels | None = Field(
        default=None, description="Dead pixels; correction fills them from their neighbours."
    )
    lag: float = Field(
        default=0.0,
        ge=0,
        lt=1,
        description="Share of a view's signal that appears in the next one. It doubles the cost.",
    )
    correction: Correction = Field(
        default=Correction(), description="How the raw images become transmission."
    )
    scatter: Scatter | None = Field(
        default=None, description="Scattered radiation; none where null."
    )

    @property
    def panel(self) -> Panel:
        """The pixel lattice."""
        pitch = self.pixel_pitch_mm
        pitch_u, pitch_v = pitch if isinstance(pitch, tuple) else (pitch, pitch)
        return Panel(self.rows, self.columns, pitch_u, pitch_v)

    @property
    def ideal(self) -> bool:
        """Whether a pixel gives the transmission of the ray through its centre.

        What a photon is worth does not matter to the transmission of one energy.
        """
        plain = Detector(
            columns=self.columns,
            rows=self.rows,
            pixel_pitch_mm=self.pixel_pitch_mm,
            response=self.response,
        )
        return self == plain
