"""Physical models for the source and detector sections of the scenario.

An unusable file, material or number raises an ``InputError`` that begins with its key.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twinct.core.draws import view_rng
from twinct.core.errors import InputError, MissingExtraError
from twinct.core.files.images import read_image
from twinct.geometry import Floats, Panel
from twinct.specimen.materials import Material, material
from twinct.specimen.sections import Composition
from twinct.xray import sections
from twinct.xray.beam_shape import BeamShape
from twinct.xray.bowtie import Bowtie
from twinct.xray.heel import HeelEffect
from twinct.xray.response import PhotonResponse
from twinct.xray.spectrum import PhotonSpectrum, attenuation
from twinct.xray.spot import gaussian_spot, image_spot, square_spot, unit_square
from twinct.xray.spread import PointSpreadFunction
from twinct.xray.tube import tube_spectrum

if TYPE_CHECKING:  # its kernels take a second to load
    from twinct.transport import AntiScatterGrid

SCINTILLATORS = {
    "CsI": Composition(formula="CsI", density_g_cm3=4.51),
    "Gd2O2S": Composition(formula="Gd2O2S", density_g_cm3=7.32),
}
"""Solid densities; state the composition of a powder screen itself."""

_FAINTEST = 1e-9
"""Minimum share of a spectrum's photons behind its filters."""


def build_spectrum(source: sections.Source) -> PhotonSpectrum:
    """Return the spectrum of the central ray behind filters and the middle of a bowtie.

    Raises:
        MissingExtraError: SpekPy is needed and not installed.
    """
    photons = source.photons_per_mm2_mas
    section, bowtie = source.spectrum, build_bowtie(source)
    if section is None:
        return PhotonSpectrum.monochromatic(source.energy_kev, photons)
    if isinstance(section, sections.TubeSpectrum):
        with _named("source.spectrum"):
            spectrum = tube_spectrum(section.kvp, section.anode_angle_deg, target=section.target)
    else:
        with _named("source.spectrum.path"):
            spectrum = PhotonSpectrum.read(section.path)
    spectrum = _filtered(spectrum, section.filters)
    if bowtie is not None:
        spectrum = spectrum.filtered(bowtie.material, float(bowtie.thickness_mm[0]))
    spectrum = spectrum.rebinned(section.bins)
    return spectrum if photons is None else spectrum.scaled(photons)


def build_bowtie(source: sections.Source) -> Bowtie | None:
    """Return the bowtie filter, if there is one."""
    section = source.bowtie
    if section is None:
        return None
    substance = material(section.material, "source.bowtie.material")
    angles = np.array(section.angles_deg, np.float64)
    return Bowtie(substance, angles, np.array(section.thickness_mm, np.float64), section.along)


def build_beam(source: sections.Source) -> BeamShape:
    """Return the free beam: the spectrum of the central ray, and what changes it elsewhere."""
    tube, heel = source.spectrum, None
    if isinstance(tube, sections.TubeSpectrum) and tube.anode_side is not None:
        heel = HeelEffect(tube.kvp, tube.anode_angle_deg, tube.target, tube.anode_side)
    return BeamShape(build_spectrum(source), heel, build_bowtie(source))


def build_grid(detector: sections.Detector) -> AntiScatterGrid | None:
    """Return the anti-scatter grid, if there is one."""
    section = detector.grid
    if section is None:
        return None
    from twinct.transport.grid import AntiScatterGrid

    strip = material(section.strip, "detector.grid.strip")
    space = material(section.space, "detector.grid.space")
    focus = math.inf if section.focus_mm is None else section.focus_mm
    widths = 10 / section.lines_per_cm, section.strip_mm
    return AntiScatterGrid(section.along, section.ratio, *widths, strip, space, focus)


def _filtered(spectrum: PhotonSpectrum, filters: Sequence[sections.Filter]) -> PhotonSpectrum:
    """Return the spectrum behind all plates; refuse it if less than ``_FAINTEST`` passes."""
    plates: list[tuple[Material, float]] = []
    problems: list[str] = []
    for i, plate in enumerate(filters):
        try:
            substance = material(plate.material, f"source.spectrum.filters.{i}.material")
            plates.append((substance, plate.thickness_mm))
        except InputError as error:
            problems += error.problems
    if problems:
        raise InputError(problems)
    depth = np.zeros_like(spectrum.photons)
    for substance, thickness in plates:
        depth += attenuation(substance, spectrum.energies_kev) * thickness
    share = float(spectrum.photons @ np.exp(-depth) / spectrum.total)
    if share < _FAINTEST:
        listed = " and ".join(f"{thickness:g} mm {what.name}" for what, thickness in plates)
        raise InputError(
            f"source.spectrum.filters: {listed} let only {share:.1g} of the photons "
            f"through; at least {_FAINTEST:g} must remain"
        )
    for substance, thickness in plates:
        spectrum = spectrum.filtered(substance, thickness)
    return spectrum


def build_response(detector: sections.Detector) -> PhotonResponse:
    """Return the response to a photon that meets grid and panel at right angles."""
    grid, response = build_grid(detector), build_panel_response(detector)
    if grid is None:
        return response
    return response.passing(lambda energies: grid.transmission(energies, 0.0, 0.0))


def build_panel_response(detector: sections.Detector) -> PhotonResponse:
    """Return the panel's response to a photon behind the grid, if there is one."""
    section = detector.response
    if isinstance(section, sections.CountingResponse):
        return PhotonResponse.counting()
    if isinstance(section, sections.IntegratingResponse):
        return PhotonResponse.integrating()
    if isinstance(section, sections.FileResponse):
        with _named("detector.response.path"):
            return PhotonResponse.read_efficiency(section.path)
    layer = section.material
    layer = SCINTILLATORS[layer] if isinstance(layer, str) else layer
    substance = material(layer, "detector.response.material")
    return PhotonResponse.scintillator(substance, section.thickness_mm, section.swank)


def effective_energy_kev(source: sections.Source, detector: sections.Detector) -> float:
    """Return the mean energy of the free beam, keV, each photon weighted with its signal.

    A specimen's true attenuation is stated at this energy, and beam hardening is corrected to it.
    """
    if source.spectrum is None:
        return source.energy_kev
    spectrum = build_spectrum(source)
    weight = spectrum.photons * build_response(detector).mean(spectrum.energies_kev)
    return float(weight @ spectrum.energies_kev / weight.sum())


def build_spot(source: sections.Source) -> Floats:
    """Return points of the focal spot in the source frame's x and y, (points, 2), mm."""
    section = source.focal_spot
    if section is None:
        return np.zeros((1, 2))
    unit = unit_square(section.samples)
    if isinstance(section, sections.GaussianSpot):
        return gaussian_spot(*_pair(section.sigma_mm), unit)
    if isinstance(section, sections.SquareSpot):
        return square_spot(*_pair(section.size_mm), unit)
    with _named("source.focal_spot.path"):
        image = read_image(section.path, "a focal spot")
        with _named(str(section.path)):
            return image_spot(image, *_pair(section.size_mm), unit)


def build_spread(detector: sections.Detector) -> PointSpreadFunction | None:
    """Return the detector's point spread; refuse a table from a file that ends too early."""
    section = detector.point_spread
    if section is None:
        return None
    if isinstance(section, sections.GaussianSpread):
        return PointSpreadFunction.gaussian(section.sigma_mm)
    panel = physical_panel(detector)
    with _named("detector.point_spread.path"):
        spread = PointSpreadFunction.read(section.path)
        with _named(str(section.path)):
            spread.check_end(min(panel.pitch_u, panel.pitch_v))
    return spread


def build_bad_pixels(detector: sections.Detector, seed: int) -> NDArray[np.bool_]:
    """Return a mask of the dead pixels, (rows, columns)."""
    shape, section = detector.panel.shape, detector.bad_pixels
    if section is None:
        return np.zeros(shape, dtype=bool)
    if isinstance(section, sections.RandomBadPixels):
        return view_rng(seed, "bad pixels", 0).random(shape) < section.share
    with _named("detector.bad_pixels.path"):
        bad = read_image(section.path, "bad pixels") != 0
        if bad.shape != shape:
            raise InputError(
                f"{section.path}: the map has {bad.shape} pixels, but the panel has {shape}"
            )
        if bad.all():
            raise InputError(
                f"{section.path}: every pixel is bad (not 0); at least one must be good"
            )
    return bad


def physical_panel(detector: sections.Detector) -> Panel:
    """Return the panel before binning."""
    return detector.panel.divided(detector.binning)


@contextmanager
def _named(origin: str) -> Iterator[None]:
    """Prefix problems with their key or file."""
    try:
        yield
    except MissingExtraError:
        raise
    except InputError as error:
        raise InputError([f"{origin}: {problem}" for problem in error.problems]) from None


def _pair(size: float | tuple[float, float]) -> tuple[float, float]:
    return size if isinstance(size, tuple) else (size, size)
