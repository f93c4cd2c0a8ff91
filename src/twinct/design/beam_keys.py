"""Settings of the beam and of the panel's signal as a page offers them, and the edits they make."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from twinct.scenario import Scenario

MONOCHROMATIC, TUBE, FILE = "monochromatic", "tube", "file"
KVP = 120
"""Voltage of a tube that has just been chosen, kV: that of ``head_screws``, usual in CT."""

Values = Mapping[str, Any]


def spectrum_of(scenario: Scenario) -> str:
    """Return the kind of a scenario's spectrum."""
    spectrum = scenario.source.spectrum
    return MONOCHROMATIC if spectrum is None else spectrum.kind


def spectra(scenario: Scenario) -> tuple[str, ...]:
    """Return the kinds that can be chosen; a file of a spectrum can only be kept."""
    return (MONOCHROMATIC, TUBE, *((FILE,) if spectrum_of(scenario) == FILE else ()))


def of_spectrum(scenario: Scenario, kind: str) -> Values:
    """Return the keys that change the kind of the spectrum."""
    if kind == spectrum_of(scenario) or kind == FILE:
        return {}
    return {"source.spectrum": None if kind == MONOCHROMATIC else {"kind": TUBE, "kvp": KVP}}


def energy_of(scenario: Scenario) -> tuple[str, float] | None:
    """Return key and value of photon energy, keV, or tube voltage, kV; None for a file."""
    source = scenario.source
    if source.spectrum is None:
        return "source.energy_kev", source.energy_kev
    if source.spectrum.kind == TUBE:
        return "source.spectrum.kvp", source.spectrum.kvp
    return None


def of_energy(scenario: Scenario, number: float) -> Values:
    """Return the keys that change photon energy or tube voltage."""
    known = energy_of(scenario)
    return {} if known is None or known[1] == number else {known[0]: number}


def of_mas(scenario: Scenario, mas: float) -> Values:
    """Return the keys that change the tube load of a view; the exposure time stays."""
    source = scenario.source
    current = float(f"{mas * 1000 / source.exposure_ms:.6g}")
    number = int(current) if current.is_integer() else current
    return {} if number == source.current_ma else {"source.current_ma": number}


def of_exposure(scenario: Scenario, exposure_ms: float) -> Values:
    """Return the keys that change the exposure time; the tube current stays."""
    return {} if exposure_ms == scenario.source.exposure_ms else {"source.exposure_ms": exposure_ms}


def of_noise(scenario: Scenario, noisy: bool) -> Values:
    """Return the keys that switch the noise of photons on, or any noise off."""
    if noisy == (scenario.detector.noise is not None):
        return {}
    return {"detector.noise": {"kind": "quantum"} if noisy else None}


def of_scatter(scenario: Scenario, scattered: bool) -> Values:
    """Return the keys that switch scatter on or off."""
    if scattered == (scenario.detector.scatter is not None):
        return {}
    return {"detector.scatter": {"kind": "monte_carlo"} if scattered else None}
