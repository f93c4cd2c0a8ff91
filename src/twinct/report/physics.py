"""Source and detector in words: only the settings of a scenario."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from twinct import scenario as sections
from twinct.geometry import MM_PER_M, Floats, Panel, Pose
from twinct.scenario import Detector, Part, Scenario, Source
from twinct.specimen.sections.composition import Composition
from twinct.xray.build import build_spectrum, effective_energy_kev


def physics_in_words(
    scenario: Scenario, source: Pose, panel: Pose, mas: Floats | None = None
) -> dict[str, str]:
    """Describe source and detector in one line each, for the report and the log.

    Photons are counted at the middle of the panel, in the view of these two poses, the first.
    ``mas`` is the tube load of all views, or None for ``source.mas``.

    Raises:
        InputError: a file is no longer usable.
        MissingExtraError: SpekPy is needed and not installed.
    """
    loads = np.atleast_1d(scenario.source.mas if mas is None else mas)
    words = [*_beam(scenario.source), *_exposure(scenario.source, loads)]
    if scenario.source.spectrum is not None:
        energy = effective_energy_kev(scenario.source, scenario.detector)
        words.append(f"mean energy seen by the detector {energy:.1f} keV")
    lattice, n = scenario.detector.panel, scenario.detector.binning
    photons = _photons(scenario.source, lattice, source, panel, float(loads[0]))
    if photons is not None:
        words.append(f"{photons:.3g} photons per pixel in the free beam")
    words += _rendered(scenario.engine, scenario.specimen.parts)
    size = f"{lattice.columns} × {lattice.rows} px of {lattice.pitch_u:g} × {lattice.pitch_v:g} mm"
    size += f", each binned from {n} × {n}" if n > 1 else ""
    return {
        "Source": "; ".join(words),
        "Detector": "; ".join(
            [size, *_signal(scenario.detector, scenario.specimen.parts), *_raw(scenario.detector)]
        ),
    }


def _rendered(engine: str | None, parts: Sequence[Part]) -> Iterator[str]:
    """Say who renders what, unless the usual engine renders all."""
    own = [part.label for part in parts if part.own_rays]
    if engine not in (None, sections.Xray().engine) or (own and engine):
        yield f"rendered by {engine}"
    if own:
        apart = f"{', '.join(own)} by " if engine else "rendered by "
        yield f"{apart}rays of {'its' if len(own) == 1 else 'their'} own"


def _photons(beam: Source, lattice: Panel, source: Pose, panel: Pose, mas: float) -> float | None:
    """Return the number of photons per image pixel in the free beam; None if it is unknown."""
    spectrum = build_spectrum(beam)
    if not spectrum.absolute:
        return None
    to_source = np.subtract(source.position, panel.position)
    distance = float(np.linalg.norm(to_source))
    cosine = float(abs(panel.rotation[:, 2] @ to_source)) / distance
    per_mm2 = spectrum.total * mas * (MM_PER_M / distance) ** 2 * cosine
    return per_mm2 * lattice.pitch_u * lattice.pitch_v


def _beam(source: Source) -> list[str]:
    section = source.spectrum
    if section is None:
        return [f"{source.energy_kev:g} keV"]
    if isinstance(section, sections.TubeSpectrum):
        kind = f"tube {section.kvp:g} kV, {section.target} at {section.anode_angle_deg:g} deg"
        if section.anode_side is not None:
            kind += f", anode towards {section.anode_side}"
    else:
        kind = f"spectrum {section.path.name}"
    plates = [f"{plate.thickness_mm:g} mm {_name(plate.material)}" for plate in section.filters]
    return [kind, *([f"filtered by {' and '.join(plates)}"] if plates else [])]


def _exposure(source: Source, mas: Floats) -> Iterator[str]:
    if source.bowtie is not None:
        yield f"bowtie of {_name(source.bowtie.material)} along {source.bowtie.along}"
    if source.photons_per_mm2_mas or isinstance(source.spectrum, sections.TubeSpectrum):
        low, high = mas.min(), mas.max()
        yield f"{low:g} mAs" if low == high else f"{low:g} to {high:g} mAs"
    spot = source.focal_spot
    if isinstance(spot, sections.GaussianSpot):
        yield f"Gaussian spot, sigma {_size(spot.sigma_mm)} mm"
    elif isinstance(spot, sections.SquareSpot):
        yield f"square spot of {_size(spot.size_mm)} mm"
    elif spot is not None:
        yield f"spot {spot.path.name} of {_size(spot.size_mm)} mm"
    if source.motion_samples > 1:
        yield f"motion blur, {source.motion_samples} instants of {source.exposure_ms:g} ms"


def _response(detector: Detector) -> list[str]:
    match detector.response:
        case sections.ScintillatorResponse(thickness_mm=thickness, material=material, swank=swank):
            words = f"{thickness:g} mm {_name(material)}"
            return [words if swank == 1 else f"{words}, Swank factor {swank:g}"]
        case sections.CountingResponse():
            return ["photon counting"]
        case sections.FileResponse(path=path):
            return [f"efficiency {path.name}"]
        case _:
            return []


def _signal(detector: Detector, parts: Sequence[Part]) -> Iterator[str]:
    """Describe the signal up to the readout; of a patient, also what it leaves out."""
    yield from _response(detector)
    spread, noise = detector.point_spread, detector.noise
    if (n := detector.pixel_samples) > 1:
        yield f"{n} × {n} samples a pixel"
    if (grid := detector.grid) is not None:
        aim = "parallel" if grid.focus_mm is None else f"focus {grid.focus_mm:g} mm"
        yield f"grid {grid.ratio:g}:1, {grid.lines_per_cm:g} lines/cm along {grid.along}, {aim}"
    if detector.scatter is not None:
        yield "scatter by Monte Carlo"
    elif not all(part.homogeneous for part in parts):
        yield "without scatter"
    if detector.lag:
        yield f"lag {100 * detector.lag:g} %"
    if isinstance(spread, sections.GaussianSpread):
        yield f"spread, sigma {spread.sigma_mm:g} mm"
    elif spread is not None:
        yield f"MTF {spread.path.name}"
    if isinstance(noise, sections.SnrNoise):
        yield f"SNR {noise.snr:g}"
    elif noise is not None:
        yield "quantum noise"


def _raw(detector: Detector) -> Iterator[str]:
    """Describe the grey values and their correction."""
    readout, bad, correction = detector.readout, detector.bad_pixels, detector.correction
    if readout is not None:
        yield (
            f"{'fractions' if readout.bits is None else f'{readout.bits} bit'}, "
            f"free beam {readout.free_beam:g} above an offset of {readout.offset:g}"
        )
        if readout.saturation is not None:
            yield f"saturation {readout.saturation:g}"
        if readout.electronic_noise:
            yield f"electronic noise {readout.electronic_noise:g}"
    if isinstance(bad, sections.RandomBadPixels):
        yield f"{100 * bad.share:g} % bad pixels"
    elif bad is not None:
        yield f"bad pixels {bad.path.name}"
    if correction.flat_frames or correction.dark_frames:
        yield f"{correction.flat_frames} flat, {correction.dark_frames} dark frames"
    if correction.flat_geometry == "first":
        yield "flat image of the first view"


def _name(material: str | Composition) -> str:
    if isinstance(material, str):
        return material
    return material.formula or " ".join(material.mass_fractions or ())


def _size(size: float | tuple[float, float]) -> str:
    return " × ".join(f"{edge:g}" for edge in (size if isinstance(size, tuple) else (size,)))
