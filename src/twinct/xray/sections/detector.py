"""Flat panel and its signal. Every default is ideal."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal, cast

from pydantic import Field, field_validator, model_validator

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
from twinct.geometry import Panel
from twinct.specimen.sections.composition import Composition


class CountingResponse(Section):
    """Ideal photon counting."""

    kind: Literal["counting"]


class IntegratingResponse(Section):
    """Ideal energy integration: every photon deposits all of its energy."""

    kind: Literal["integrating"] = "integrating"


class ScintillatorResponse(Section):
    """Scintillator: every attenuated photon is absorbed, and deposits all of its energy.

    Its light scatters: see ``swank`` and ``detector.point_spread``.
    """

    kind: Literal["scintillator"]
    material: Literal["CsI", "Gd2O2S"] | Composition = setting(
        "CsI",
        "Scintillator. CsI has a density of 4.51 g/cm^3, Gd2O2S of 7.32 g/cm^3.",
        source="attenuation: xraylib",
    )
    thickness_mm: Length = Field(
        description="Thickness t; it absorbs the share 1 - exp(-mu t) of the photons.",
        json_schema_extra=facts(source="Beer-Lambert"),
    )
    swank: float = setting(
        1.0,
        "Swank factor: equal photons give different amounts of light, which divides the number of "
        "photons that quantum noise is equal to by 1 / swank. 1: equal amounts. "
        "twinct.xray.response.swank_factor computes it from a pulse-height spectrum.",
        gt=0,
        le=1,
        source="Swank, J. Appl. Phys. 44 (1973) 4199",
    )


class FileResponse(Section):
    """A measured quantum efficiency."""

    kind: Literal["file"]
    path: Path = Field(
        description="Two columns: energy in keV (rising), share of photons absorbed (0 to 1). "
        "At most 0.1 % of the source's photons may lie outside this energy range."
    )


Response = Annotated[
    CountingResponse | IntegratingResponse | ScintillatorResponse | FileResponse,
    Field(discriminator="kind"),
]


class GaussianSpread(Section):
    """A Gaussian point spread."""

    kind: Literal["gaussian"]
    sigma_mm: Length = Field(
        description="Standard deviation: the basic spatial resolution of ISO 19232-5 divided by "
        "1.41.",
        json_schema_extra=facts(source="ISO 19232-5"),
    )


class FileSpread(Section):
    """A measured modulation transfer function."""

    kind: Literal["mtf"]
    path: Path = Field(
        description="Two columns: spatial frequency in 1/mm (rising from 0), modulation (1 at "
        "0; 0 to 1.05). It is interpolated linearly, and is 0 beyond the last row, which must "
        "lie at or above the Nyquist frequency of the physical pixels, or have a modulation of "
        "at most 0.1."
    )


PointSpread = Annotated[GaussianSpread | FileSpread, Field(discriminator="kind")]


class QuantumNoise(Section):
    """Poisson noise of the photons that the detector absorbs."""

    kind: Literal["quantum"]


class SnrNoise(Section):
    """Normal noise of a given signal-to-noise ratio; it grows with the root of the signal."""

    kind: Literal["snr"]
    snr: Positive = Field(
        description="Signal-to-noise ratio of the free beam, at the centre of the first view's "
        "panel.",
        json_schema_extra=facts(source="as in CTSimU files"),
    )
    gain: Positive = setting(
        1.0,
        "Noise of a pixel relative to what it would be if neighbours did not share it. Below 1 for "
        "an imported scan whose detector blurs; a simulated scan has 1: kind 'quantum' and a "
        "point_spread simulate blurred noise.",
    )


Noise = Annotated[QuantumNoise | SnrNoise, Field(discriminator="kind")]


class Readout(Section):
    """Amplifier and converter. Without this section, pixel values keep their fractions."""

    free_beam: Positive = setting(
        50000.0,
        "Grey value of the free beam above the offset, at the centre of the first view's panel, "
        "for the largest mAs of all views. It sets the gain.",
        unit="grey values",
    )
    offset: NonNegative = setting(500.0, "Grey value without beam.", unit="grey values")
    electronic_noise: NonNegative = setting(
        0.0, "Standard deviation of the noise without beam.", unit="grey values"
    )
    bits: int | None = setting(
        16, "Bit depth; null: values keep their fractions.", ge=1, le=32, unit="bit"
    )
    saturation: Positive | None = setting(
        None,
        "Grey value of saturation; null: the largest value of the converter. The free beam, "
        "offset + free_beam, must not exceed it.",
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
        end = f"the largest {self.bits}-bit value ({self.largest:g})"
        if self.largest == self.saturation:
            end = f"saturation ({self.largest:g})"
        if self.offset >= self.largest:
            message = f"offset ({self.offset:g}) must be below {end}, or no signal can be read"
        else:
            message = (
                f"the free beam saturates: offset ({self.offset:g}) + free_beam "
                f"({self.free_beam:g}) = {beam:g} exceeds {end}"
            )
        raise ConflictError(Conflict(message, ("free_beam", "offset", "saturation", "bits")))


class RandomBadPixels(Section):
    """Dead pixels at random positions, drawn from the scenario's seed."""

    kind: Literal["random"]
    share: float = Field(gt=0, lt=0.5, description="Share of all pixels that are dead.")


class FileBadPixels(Section):
    """Dead pixels from a map."""

    kind: Literal["file"]
    path: Path = Field(
        description=".npy file or image of the panel's shape; bad pixels are nonzero."
    )


BadPixels = Annotated[RandomBadPixels | FileBadPixels, Field(discriminator="kind")]


class Correction(Section):
    """Flat and dark images, acquired without specimen before the scan."""

    flat_frames: int = setting(
        0, "Number of flat frames to average; 0: a flat image without noise.", ge=0
    )
    dark_frames: int = setting(
        0, "Number of dark frames to average; 0: a dark image without noise.", ge=0
    )
    flat_geometry: Literal["commanded", "first", "view"] = setting(
        "commanded",
        "Geometry of the flat images. commanded and first use one flat image, taken at the first "
        "commanded view. commanded: the flat image is scaled by distance and tilt to each "
        "commanded view, so that the errors of the arms stay in the image; first: it is used "
        "unchanged; view: a flat image at each executed view, which no machine can take.",
    )


class MonteCarloScatter(Section):
    """Scattered radiation of all orders, from photons that are followed through the specimen.

    It is simulated for a few views on coarse pixels, and interpolated. It has random numbers of its
    own, so that scans of any seed share it. Details: ``twinct.xray.monte_carlo_scatter``.
    """

    kind: Literal["monte_carlo"]
    photons: int = setting(
        1_000_000, "Photons of each simulated view.", ge=1000, le=10**12, unit="photons"
    )
    views: int = setting(16, "Views that are simulated; fewer if the scan has fewer.", ge=1)
    voxel_mm: Length = setting(2.0, "Edge of the voxels that stand for the specimen.")
    pixel_mm: Length = setting(20.0, "Edge of the coarse pixels, about.")


class AntiScatterGrid(Section):
    """Anti-scatter grid before the panel, fixed to it; its lines are not seen.

    It lets the same share of primary and scattered photons pass that meets it from one direction.
    """

    along: Literal["u", "v"] = Field(description="Axis of the panel along which the strips run.")
    ratio: float = Field(
        ge=1, le=50, description="Height of the strips by the width of the spaces between them."
    )
    lines_per_cm: float = Field(
        ge=1, le=200, description="Strips per cm.", json_schema_extra=facts(unit="1/cm")
    )
    strip_mm: Length = Field(description="Width of a strip; it must leave a space.")
    focus_mm: Length | None = Field(
        description="Distance from the panel to the line at which the strips aim, over the panel's "
        "middle; null: parallel strips. Source and panel at another distance lose light at the "
        "edges (cut-off)."
    )
    strip: str | Composition = setting("lead", "Material of the strips.")
    space: str | Composition = setting("aluminium", "Material of the spaces.")

    @model_validator(mode="after")
    def _leaves_spaces(self) -> AntiScatterGrid:
        period = 10 / self.lines_per_cm
        if self.strip_mm >= period:
            message = (
                f"strips of {self.strip_mm:g} mm leave no space: {self.lines_per_cm:g} lines per "
                f"cm are {period:.3g} mm apart"
            )
            raise ConflictError(Conflict(message, ("strip_mm", "lines_per_cm")))
        return self


class Detector(Section):
    """Flat panel; a lattice of ideal pixels by default."""

    columns: int = setting(
        640, "Pixels along u.", ge=1, le=8192, unit="px", source="the paper", read_by="plan"
    )
    rows: int = setting(
        480, "Pixels along v.", ge=1, le=8192, unit="px", source="the paper", read_by="plan"
    )
    pixel_pitch_mm: Length | Pair = setting(
        0.5, "Pixel pitch; two numbers for (u, v).", source="the paper", read_by="plan"
    )
    response: Response = setting(
        IntegratingResponse(), "Signal that the detector produces for each photon."
    )
    pixel_samples: int = setting(
        1,
        "Samples along each edge of a pixel; the pixel value is their mean. The cost grows with "
        "the square of this number.",
        ge=1,
        le=16,
        source="1: the paper's gVXR",
    )
    binning: Annotated[int, Field(ge=1, le=8)] = setting(
        1,
        "Physical pixels along each edge of an image pixel; noise and spread act on the "
        "physical pixels.",
    )
    point_spread: PointSpread | None = setting(
        None, "Point spread of the signal.", source="none: the paper"
    )
    noise: Noise | None = setting(None, "Noise of the signal.", source="none: the paper")
    readout: Readout | None = setting(None, "Conversion to grey values.")
    bad_pixels: BadPixels | None = setting(
        None, "Dead pixels; correction fills them from their neighbours.", read_by="volume"
    )
    frame_ms: float | None = setting(
        None,
        "Shortest time from one image to the next that the detector allows, 1000 / frames per "
        "second; null: only the exposure time limits it. The plan of the arms respects both times.",
        gt=0,
        le=60_000,
        read_by="executed",
    )
    lag: float = setting(
        0.0,
        "Share of a view's signal that remains in the next view. A lag above 0 doubles the cost.",
        ge=0,
        lt=1,
    )
    correction: Correction = setting(
        Correction(), "Correction that turns raw images into transmission."
    )
    scatter: MonteCarloScatter | None = setting(None, "Scattered radiation; null: none.")
    grid: AntiScatterGrid | None = setting(None, "Anti-scatter grid before the panel; null: none.")
    keep: tuple[Literal["raw", "flat", "dark"], ...] = setting(
        (),
        "Images that the scan store keeps for each view beside the transmission, in grey "
        "values. Each view is then rendered twice. An ideal source and detector have no such "
        "images, and the key is refused.",
    )

    @field_validator("scatter", mode="before")
    @classmethod
    def _no_kernel(cls, value: Any) -> Any:
        kind = cast("dict[str, Any]", value).get("kind") if isinstance(value, dict) else None
        if kind == "kernel":
            raise ValueError(
                "kind 'kernel' is gone: it found half of the scatter behind a patient; take "
                "{kind: monte_carlo}"
            )
        return cast("Any", value)

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
        exempt = ("columns", "rows", "pixel_pitch_mm", "response", "keep", "frame_ms")
        return self == Detector(**{name: getattr(self, name) for name in exempt})
