"""Flat panel and its signal. Every default is ideal."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from twinct.geometry import Panel
from twinct.scenario.composition import Composition
from twinct.settings import (
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


class CountingResponse(Section):
    """Ideal photon counting."""

    kind: Literal["counting"]


class IntegratingResponse(Section):
    """Ideal energy integration: every photon deposits all of its energy."""

    kind: Literal["integrating"] = "integrating"


class ScintillatorResponse(Section):
    """Scintillator: every attenuated photon is absorbed, and deposits all of its energy."""

    kind: Literal["scintillator"]
    material: Literal["CsI", "Gd2O2S"] | Composition = setting(
        "CsI", "Scintillator. CsI has 4.51, Gd2O2S 7.32 g/cm^3.", source="attenuation: xraylib"
    )
    thickness_mm: Length = Field(
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
    sigma_mm: Length = Field(
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
    """Amplifier and converter. Without this section, pixel values keep their fractions."""

    free_beam: Positive = setting(
        50000.0,
        "Grey value of the free beam, above the offset, at the middle of the first "
        "view's panel, with the largest mAs of all views: it sets the gain.",
        unit="grey values",
    )
    offset: NonNegative = setting(500.0, "Grey value without beam.", unit="grey values")
    electronic_noise: NonNegative = setting(
        0.0, "Standard deviation of the noise without beam.", unit="grey values"
    )
    bits: int | None = setting(16, "Bit depth; null keeps fractions.", ge=1, le=32, unit="bit")
    saturation: Positive | None = setting(
        None,
        "Grey value of saturation; the converter's largest where null. The free beam "
        "stays below it: offset + free_beam.",
        unit="grey values",
    )

    @property
    def largest(self) -> float:
        """Largest possible grey value."""
        ends = (None if self.bits is None else 2.0**self.bits - 1, self.saturation)
        return min((end for end in ends if end is not None), default=math.inf)

    @model_validator(mode="after")
    def _free_beam_fits(self) -> Readout:
        beam = self.offset + self.free_beam
        if beam <= self.largest:
            return self
        end = f"the largest value of {self.bits} bits ({self.largest:g})"
        if self.largest == self.saturation:
            end = f"saturation ({self.largest:g})"
        if self.offset >= self.largest:
            message = f"offset ({self.offset:g}) must be below {end}: no signal could be read"
        else:
            message = (
                f"the free beam saturates: offset ({self.offset:g}) + free_beam "
                f"({self.free_beam:g}) = {beam:g} exceeds {end}"
            )
        raise ConflictError(Conflict(message, ("free_beam", "offset", "saturation", "bits")))


class RandomBadPixels(Section):
    """Dead pixels at random positions, drawn from the scenario's seed."""

    kind: Literal["random"]
    share: float = Field(gt=0, lt=0.5, description="Of all pixels.")


class FileBadPixels(Section):
    """Dead pixels from a map."""

    kind: Literal["file"]
    path: Path = Field(description=".npy or image of the panel's shape; a bad pixel is not zero.")


BadPixels = Annotated[RandomBadPixels | FileBadPixels, Field(discriminator="kind")]


class Correction(Section):
    """Flat and dark images, acquired without specimen before the scan."""

    flat_frames: int = setting(0, "Flat frames averaged; 0 for a flat image without noise.", ge=0)
    dark_frames: int = setting(0, "Dark frames averaged; 0 for a dark image without noise.", ge=0)
    flat_geometry: Literal["commanded", "first", "view"] = setting(
        "commanded",
        "All but view take one flat image, at the first commanded view. commanded: "
        "scaled by distance and tilt to where each view was commanded to be, so that what the arms "
        "miss by stays in the image; first: as it is; view: as if one had been taken where each "
        "view was executed, which no machine can do.",
    )


class Scatter(Section):
    """Scattered radiation, a forward-scatter estimate; its validity: ``twinct.xray.scatter``."""

    kind: Literal["kernel"]
    scale: NonNegative = setting(
        1.0,
        "Factor: above 1 for scatter of higher order, below 1 for a grid.",
        source="kernel: Ohnesorge et al., Eur. Radiol. 9 (1999) 563, and Klein-Nishina",
    )


class Detector(Section):
    """Flat panel; a lattice of ideal pixels by default."""

    columns: int = setting(640, "Pixels along u.", ge=1, le=8192, unit="px", source="the paper")
    rows: int = setting(480, "Pixels along v.", ge=1, le=8192, unit="px", source="the paper")
    pixel_pitch_mm: Length | Pair = setting(
        0.5, "Pixel pitch; two numbers for (u, v).", source="the paper"
    )
    response: Response = setting(IntegratingResponse(), "What the detector makes of a photon.")
    pixel_samples: int = setting(
        1,
        "Samples along each edge of a pixel; its value is their mean. The cost grows "
        "with their square.",
        ge=1,
        le=16,
        source="1: the paper's gVXR",
    )
    binning: Annotated[int, Field(ge=1, le=8)] = setting(
        1,
        "Physical pixels along each edge of an image pixel; noise and spread happen in "
        "the physical ones.",
    )
    point_spread: PointSpread | None = setting(
        None, "Spread of the signal.", source="none: the paper"
    )
    noise: Noise | None = setting(None, "Noise of the signal.", source="none: the paper")
    readout: Readout | None = setting(None, "Grey values.")
    bad_pixels: BadPixels | None = setting(
        None, "Dead pixels; correction fills them from their neighbours."
    )
    lag: float = setting(
        0.0,
        "Share of a view's signal that appears in the next one. It doubles the cost.",
        ge=0,
        lt=1,
    )
    correction: Correction = setting(Correction(), "How the raw images become transmission.")
    scatter: Scatter | None = setting(None, "Scattered radiation; none where null.")
    keep: tuple[Literal["raw", "flat", "dark"], ...] = setting(
        (),
        "Images that the scan store keeps of each view beside the transmission, in grey values; "
        "not of an ideal source and detector, which have none. Each view is then rendered twice.",
    )

    @property
    def panel(self) -> Panel:
        """Pixel lattice."""
        pitch = self.pixel_pitch_mm
        pitch_u, pitch_v = pitch if isinstance(pitch, tuple) else (pitch, pitch)
        return Panel(self.rows, self.columns, pitch_u, pitch_v)

    @property
    def ideal(self) -> bool:
        """True if each pixel measures the transmission of the ray through its centre.

        The response is ignored: it cancels out of the transmission at a single energy.
        """
        kept = ("columns", "rows", "pixel_pitch_mm", "response", "keep")
        return self == Detector(**{name: getattr(self, name) for name in kept})
