"""What a CTSimU file says of one frame, in our units and poses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from twinct.files.images import RawImage
from twinct.geometry import Floats, Panel, Pose, ScanGeometry
from twinct.specimen import Material


@dataclass(frozen=True)
class Layer:
    """A plane absorber: window, filter or scintillator."""

    material: Material
    thickness_mm: float


@dataclass(frozen=True)
class FocalSpot:
    """The focal spot, in the plane of the source's u and v.

    Attributes:
        size_mm: of the rectangle along u and v; 0 where the file leaves it open.
        sigma_mm: of a Gaussian along u and v; 0 for none.
        image: intensity over the rectangle, or None. Row 0 is at -v, column 0 at -u.
    """

    size_mm: tuple[float, float]
    sigma_mm: tuple[float, float]
    image: Path | RawImage | None

    @property
    def is_point(self) -> bool:
        """Whether it has no extent."""
        return self.image is None and max(*self.size_mm, *self.sigma_mm) == 0


@dataclass(frozen=True)
class Tube:
    """What leaves the source.

    Attributes:
        voltage_kv: tube voltage; the energy in keV where monochromatic.
        spectrum: file of energy in keV and photons in 1/(s sr mA), behind the window.
        window: filters a spectrum that is calculated here; ``filters`` are for every spectrum.
        take_off_deg: between target surface and central ray.
    """

    voltage_kv: float
    current_ma: float
    monochromatic: bool
    spectrum: Path | None
    window: tuple[Layer, ...]
    filters: tuple[Layer, ...]
    take_off_deg: float | None


@dataclass(frozen=True)
class PanelResponse:
    """How the detector turns radiation into grey values.

    Attributes:
        real: the scintillator or the efficiency file counts; else all energy does.
        front: layers before the scintillator.
        efficiency: file of energy in keV and share of photons that count.
        imin: grey value without radiation.
        imax: largest grey value of the free beam in frame 0.
        factor: grey values for each J in a pixel, or None.
        offset: grey value at 0 J, or None.
        curve: file of J in a pixel and grey value, or None.
        snr: signal to noise at ``imax``, one frame; None for no noise.
        noise: file of grey value and SNR, or None.
        resolution_mm: basic spatial resolution; 0 for none.
        mtf: file of line pairs per mm and contrast, or None.
        lag: share of a frame's signal that is left in the next.
        bad_pixels: -1 for a good pixel, else its grey value.
    """

    real: bool
    scintillator: Layer | None
    front: tuple[Layer, ...]
    efficiency: Path | None
    imin: float
    imax: float
    factor: float | None
    offset: float | None
    curve: Path | None
    bits: int
    snr: float | None
    noise: Path | None
    resolution_mm: float
    mtf: Path | None
    lag: float
    bad_pixels: Path | RawImage | None


@dataclass(frozen=True)
class Sample:
    """A sample in one frame, of vacuum where it has no material.

    Attributes:
        scale: mm for each unit of the file, along its x, y and z.
        world_from_sample: axes r, s, t and the centre of the mesh's bounding box.
    """

    name: str
    file: Path
    scale: tuple[float, float, float]
    material: Material | None
    world_from_sample: Pose


@dataclass(frozen=True)
class Frame:
    """All of one frame.

    Attributes:
        view: source and panel in the world, in our convention.
        upside_down: row 0 of a CTSimU image is our last row.
        source_axes: u and v of the source, (2, 3): the focal spot's plane.
        samples: where two overlap the later one counts.
        environment: fills the room, or None.
        binning: pixels put together along (u, v).
    """

    view: ScanGeometry
    upside_down: bool
    source_axes: Floats
    spot: FocalSpot
    world_from_stage: Pose
    samples: tuple[Sample, ...]
    environment: Material | None
    tube: Tube
    response: PanelResponse
    exposure_s: float
    binning: tuple[int, int]

    @property
    def panel(self) -> Panel:
        """The pixels before binning."""
        return self.view.panel


@dataclass(frozen=True)
class FieldImages:
    """Dark or flat images: ideal ones have no noise; projections may come out corrected by them."""

    number: int
    average: int
    ideal: bool
    correction: bool
