"""One frame of a CTSimU file, in our units and poses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from twinct.core.files.images import RawImage
from twinct.geometry import Floats, Panel, Pose, ScanGeometry
from twinct.specimen import Material


@dataclass(frozen=True)
class Layer:
    """Plane absorber: window, filter or scintillator."""

    material: Material
    thickness_mm: float


@dataclass(frozen=True)
class FocalSpot:
    """Focal spot in the plane of the source's u and v.

    Attributes:
        size_mm: size of the rectangle along u and v; 0 if the file does not state it.
        sigma_mm: sigma of a Gaussian along u and v; 0 for none.
        image: intensity over the rectangle, or None. Row 0 is at -v, column 0 at -u.
    """

    size_mm: tuple[float, float]
    sigma_mm: tuple[float, float]
    image: Path | RawImage | None

    @property
    def is_point(self) -> bool:
        """True if the focal spot has no extent."""
        return self.image is None and max(*self.size_mm, *self.sigma_mm) == 0


@dataclass(frozen=True)
class Tube:
    """X-ray tube with its filters.

    Attributes:
        voltage_kv: tube voltage; the energy in keV if monochromatic.
        spectrum: file of energy in keV and photons in 1/(s sr mA), behind the window.
        window: filters for a calculated spectrum; ``filters`` apply to every spectrum.
        take_off_deg: angle between target surface and central ray.
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
    """Conversion of radiation to grey values by the detector.

    Attributes:
        real: True if the scintillator or the efficiency file applies; else all energy counts.
        front: layers before the scintillator.
        efficiency: file of energy in keV and share of counted photons.
        imin: grey value without radiation.
        imax: largest grey value of the free beam in frame 0.
        factor: grey values per J in a pixel, or None.
        offset: grey value at 0 J, or None.
        curve: file of J in a pixel and grey value, or None.
        snr: signal-to-noise ratio at ``imax``, one frame; None without noise.
        noise: file of grey value and SNR, or None.
        resolution_mm: basic spatial resolution; 0 for none.
        mtf: file of line pairs per mm and contrast, or None.
        lag: share of a frame's signal that remains in the next.
        bad_pixels: image of -1 for a good pixel, else its grey value.
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
    """A sample in one frame; of vacuum if it has no material.

    Attributes:
        scale: mm per unit of the file, along its x, y and z.
        world_from_sample: pose with axes r, s, t, at the centre of the mesh's bounding box.
    """

    name: str
    file: Path
    scale: tuple[float, float, float]
    material: Material | None
    world_from_sample: Pose


@dataclass(frozen=True)
class Frame:
    """One frame with all its settings.

    Attributes:
        view: source and panel in the world, in our convention.
        upside_down: True if row 0 of a CTSimU image is our last row.
        source_axes: u and v of the source, (2, 3): the focal spot's plane.
        samples: samples; the later one counts where two overlap.
        environment: medium that fills the room, or None.
        binning: binned pixels along (u, v).
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
        """Panel before binning."""
        return self.view.panel


@dataclass(frozen=True)
class DarkOrFlatImages:
    """Number of dark or flat images; ``ideal`` omits noise, ``correction`` corrects projections."""

    number: int
    average: int
    ideal: bool
    correction: bool
