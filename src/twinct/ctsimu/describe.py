"""Source and detector of a twinct scenario in CTSimU terms; unsupported features are refused."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twinct import scenario as sections
from twinct.core.errors import InputError
from twinct.core.files.tables import read_columns
from twinct.core.files.writing import write_text
from twinct.ctsimu.camera import MM2_AT_1M_PER_SR
from twinct.ctsimu.writing import Json, as_material, quantity
from twinct.geometry import Floats
from twinct.scenario import Detector, Source
from twinct.specimen import Material, material
from twinct.xray.build import SCINTILLATORS, build_spectrum, physical_panel

FREE_BEAM = 60000


@dataclass(frozen=True)
class Description:
    """Sections of a CTSimU file; ``acquisition`` holds only binning, dark and flat images."""

    source: Json
    detector: Json
    acquisition: Json
    materials: list[Json]


def refuse_unsaid(source: Source, detector: Detector, *, uneven_mas: bool = False) -> None:
    """Raise an ``InputError`` that names every key without a CTSimU equivalent.

    ``uneven_mas``: views have individual mAs.
    """
    # ``photons_per_mm2_mas`` of a monochromatic source and photon counting at one energy have no
    # equivalent either; but without quantum noise they change no transmission.
    spot, counting = source.focal_spot, isinstance(detector.response, sections.CountingResponse)
    table = {
        "source.focal_spot": spot is not None and not isinstance(spot, sections.GaussianSpot),
        "source.spectrum.anode_side": (
            isinstance(source.spectrum, sections.TubeSpectrum)
            and source.spectrum.anode_side is not None
        ),
        "source.bowtie": source.bowtie is not None,
        "source.motion_samples": source.motion_samples > 1,
        "detector.response": source.spectrum is not None and counting,
        "detector.noise": isinstance(detector.noise, sections.QuantumNoise),
        "detector.readout": detector.readout is not None,
        "detector.bad_pixels": detector.bad_pixels is not None,
        # CTSimU's lag accumulates over images, ours affects only the next one.
        "detector.lag": detector.lag > 0,
        "detector.scatter": detector.scatter is not None,
        "detector.grid": detector.grid is not None,
        "trajectory.path (mas)": uneven_mas,
    }
    problems = [f"{key}: CTSimU cannot express this" for key, wrong in table.items() if wrong]
    if problems:
        raise InputError([*problems, "--ideal exports an ideal source and detector instead"])


def render_options(source: Source, detector: Detector) -> str:
    """Return ``twinct ctsimu render`` options for the scan's sampling, which the format lacks."""
    spot = source.focal_spot
    if spot is None:
        return f"--samples {detector.pixel_samples}"
    return f"--spot-points {spot.samples}"


def describe(
    source: Source, detector: Detector, folder: Path, name: str, ideal: bool
) -> Description:
    """Describe source and detector, and write their curves to files in the folder.

    ``name`` is the prefix of the files. Call ``refuse_unsaid`` first, unless ``ideal`` replaces the
    scenario's source and detector with a monochromatic point and an ideal panel.
    """
    panel = physical_panel(detector)
    seen: Json = {
        "type": "ideal",
        "columns": quantity(panel.columns, "px"),
        "rows": quantity(panel.rows, "px"),
        "pixel_pitch": {"u": quantity(panel.pitch_u, "mm"), "v": quantity(panel.pitch_v, "mm")},
        "bit_depth": quantity(16),
        "integration_time": quantity(source.exposure_ms, "ms"),
        "gray_value": {"imax": quantity(FREE_BEAM), "imin": quantity(0)},
    }
    beam: Json = {
        "voltage": quantity(source.energy_kev, "kV"),
        "current": quantity(source.current_ma, "mA"),
        "spectrum": {"monochromatic": True, "file": None},
        "window": [],
        "filters": [],
    }
    materials: list[Json] = []
    correction = sections.Correction() if ideal else detector.correction
    if not ideal:
        beam |= _beam(source, folder, name)
        more, materials = _seen(detector, folder, name)
        more["gray_value"] = seen["gray_value"] | more.get("gray_value", {})
        seen |= more
    acquisition = {
        "dark_field": _fields(correction.dark_frames, without_noise=0),
        # One image of frame 0: ``flat_geometry: first``, except for the arms' pose error there.
        "flat_field": _fields(correction.flat_frames, without_noise=1),
        "pixel_binning": {axis: detector.binning for axis in "uv"},
    }
    return Description(beam, seen, acquisition, materials)


def _fields(frames: int, without_noise: int) -> Json:
    """Return a section for dark or flat images; they have no noise if no frames are averaged."""
    number = 1 if frames else without_noise
    return {"number": number, "frame_average": max(frames, 1), "ideal": not frames}


def _beam(source: sections.Source, folder: Path, name: str) -> Json:
    beam: Json = {}
    if source.spectrum is not None:
        spectrum = build_spectrum(source)
        photons = spectrum.photons * MM2_AT_1M_PER_SR
        file = _table(folder / f"{name}_spectrum.tsv", spectrum.energies_kev, photons)
        beam["spectrum"] = {"monochromatic": False, "file": file}
        beam["voltage"] = quantity(float(spectrum.energies_kev[-1]), "kV")
    if isinstance(source.focal_spot, sections.GaussianSpot):
        sigma = source.focal_spot.sigma_mm
        across, down = sigma if isinstance(sigma, tuple) else (sigma, sigma)
        spot = {"u": quantity(across, "mm"), "v": quantity(down, "mm")}
        beam["spot"] = {"sigma": spot | {"w": quantity(0.0, "mm")}}
    return beam


def _seen(detector: sections.Detector, folder: Path, name: str) -> tuple[Json, list[Json]]:
    results: Json = {}
    materials: list[Json] = []
    response, spread = detector.response, detector.point_spread
    if isinstance(response, sections.ScintillatorResponse):
        layer = _substance(response.material)
        materials.append(as_material(layer))
        thickness = quantity(response.thickness_mm, "mm")
        results["type"] = "real"
        results["scintillator"] = {"material_id": layer.name, "thickness": thickness}
    elif isinstance(response, sections.FileResponse):
        file = _table(folder / f"{name}_efficiency.tsv", *read_columns(response.path, 2))
        results["type"] = "real"
        results["gray_value"] = {"efficiency_characteristics_file": file}
    if isinstance(spread, sections.GaussianSpread):
        panel = physical_panel(detector)
        pixel = panel.pitch_u * panel.pitch_v / 12
        # The resolution includes the pixel: see ``Digitiser._sigma_mm``.
        resolution = float(np.sqrt(2 * (spread.sigma_mm**2 + pixel)))
        results["unsharpness"] = {"basic_spatial_resolution": quantity(resolution, "mm")}
    elif isinstance(spread, sections.FileSpread):
        file = _table(folder / f"{name}_mtf.tsv", *read_columns(spread.path, 2))
        results["unsharpness"] = {"mtf": file}
    if isinstance(detector.noise, sections.SnrNoise):
        # CTSimU states the SNR of a physical pixel; binning n x n pixels raises it n times.
        results["noise"] = {"snr_at_imax": quantity(detector.noise.snr / detector.binning)}
    return results, materials


def _substance(of: str | sections.Composition) -> Material:
    if isinstance(of, str):
        made = material(SCINTILLATORS[of])
        return Material(of, made.density_g_cm3, made.mass_fractions)
    return material(of)


def _table(path: Path, first: Floats, second: Floats) -> Json:
    """Write two columns to a file, and return a reference to the file."""
    lines = [f"{a:.12g}\t{b:.12g}\n" for a, b in zip(first, second, strict=True)]
    write_text(path, "".join(lines))
    return {"value": path.name}
