"""From transmission to line integrals, with beam hardening corrected."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import ScanGeometry
from twinct.scan import Scan, Workshop
from twinct.scenario import Scenario

DARKEST = 1e-7
"""Transmission taken for anything darker, so that a line integral stays finite (16.1)."""


def line_integrals(transmission: NDArray[np.float32]) -> NDArray[np.float32]:
    """-ln(I/I0) of each pixel, float32, same shape."""
    darkest = np.float32(DARKEST)
    integrals = np.maximum(transmission, darkest)
    np.log(integrals, out=integrals)
    return np.negative(integrals, out=integrals)


def corrected_integrals(scan: Scan, geometry: ScanGeometry) -> NDArray[np.float32]:
    """Line integrals of a scan, with beam hardening corrected where the scenario asks for it.

    Args:
        scan: projections.
        geometry: from which the volume that two materials need is reconstructed.
    """
    integrals = line_integrals(scan.transmission)
    section = scan.scenario.reconstruction.beam_hardening
    if section is None:
        return integrals
    from twinct.specimen.materials import material
    from twinct.xray.build import build_response, build_spectrum
    from twinct.xray.hardening import Hardening

    source, detector = scan.scenario.source, scan.scenario.detector
    energy = effective_energy(scan.scenario)
    known = build_spectrum(source), build_response(detector)
    origin = "reconstruction.beam_hardening"
    if section.kind == "one_material":
        if section.material is None:
            substance = Workshop(scan.scenario).specimen.reference_part.material
        else:
            substance = material(section.material, f"{origin}.material")
        return Hardening(*known, [substance], energy).correct(integrals)

    from twinct.recon import Projector, sart

    base, dense = (material(getattr(section, n), f"{origin}.{n}") for n in ("base", "dense"))
    projector = Projector(geometry, scan.scenario.reconstruction.grid.volume_grid)
    volume = sart(
        projector,
        Hardening(*known, [base], energy).correct(integrals),
        iterations=section.first_iterations,
        relaxation=scan.scenario.reconstruction.relaxation,
    )
    low, high = base.mu_per_mm(energy), dense.mu_per_mm(energy)
    # From a quarter to three quarters of the step between them: noise counts as neither.
    share = np.clip(2 * (volume - low) / (high - low) - 0.5, 0, 1).astype(np.float32)
    paths = projector(share)
    hardening = Hardening(*known, [base, dense], energy, float(paths.max()))
    return np.stack([hardening.correct(*view) for view in zip(integrals, paths, strict=True)])


def effective_energy(scenario: Scenario) -> float:
    """Photon energy at which attenuation is stated, keV: the mean one that the detector sees."""
    if scenario.source.spectrum is None:
        return scenario.source.energy_kev
    from twinct.xray.build import effective_energy_kev

    return effective_energy_kev(scenario.source, scenario.detector)
