"""Beam hardening of a scan: from its scenario to corrected line integrals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import ScanGeometry
from twinct.scan import Workshop
from twinct.scenario import Scenario


def hardening_corrected(
    scenario: Scenario, integrals: NDArray[np.float32], geometry: ScanGeometry
) -> NDArray[np.float32]:
    """Line integrals at one energy, where the scenario asks for it.

    Args:
        scenario: source, detector, materials.
        integrals: polychromatic ones, (views, rows, columns).
        geometry: from which the volume that two materials need is reconstructed.
    """
    section = scenario.reconstruction.beam_hardening
    if section is None:
        return integrals
    from twinct.specimen.materials import material
    from twinct.xray.build import build_response, build_spectrum
    from twinct.xray.hardening import Hardening

    source, detector = scenario.source, scenario.detector
    energy = effective_energy(scenario)
    known = build_spectrum(source), build_response(detector)
    origin = "reconstruction.beam_hardening"
    if section.kind == "one_material":
        if section.material is None:
            substance = Workshop(scenario).specimen.reference_part.material
        else:
            substance = material(section.material, f"{origin}.material")
        return Hardening(*known, [substance], energy).correct(integrals)

    from twinct.recon import Projector, sart

    base, dense = (material(getattr(section, n), f"{origin}.{n}") for n in ("base", "dense"))
    projector = Projector(geometry, scenario.reconstruction.grid.volume_grid)
    volume = sart(
        projector,
        Hardening(*known, [base], energy).correct(integrals),
        iterations=section.first_iterations,
        relaxation=scenario.reconstruction.relaxation,
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
