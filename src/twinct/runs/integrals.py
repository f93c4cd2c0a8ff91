"""Beam hardening of a scan: from its scenario to corrected line integrals."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twinct.errors import InputError
from twinct.geometry import ScanGeometry
from twinct.scan import Workshop
from twinct.scenario import BeamHardening, Scenario

if TYPE_CHECKING:
    from twinct.specimen.materials import Material

_KEY = "reconstruction.beam_hardening"


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
    from twinct.xray.build import build_response, build_spectrum
    from twinct.xray.hardening import Hardening

    source, detector = scenario.source, scenario.detector
    energy = effective_energy(scenario)
    known = build_spectrum(source), build_response(detector)
    materials = _materials(section)
    if section.kind == "one_material":
        substances = materials or [Workshop(scenario).specimen.reference_part.material]
        return Hardening(*known, substances, energy).correct(integrals)

    from twinct.recon import Projector, sart

    base, dense = materials
    projector = Projector(geometry, scenario.reconstruction.grid.volume_grid)
    volume = sart(
        projector,
        Hardening(*known, [base], energy).correct(integrals),
        iterations=section.first_iterations,
        relaxation=getattr(scenario.reconstruction, "relaxation", 0.3),
    )
    low, high = base.mu_per_mm(energy), dense.mu_per_mm(energy)
    # From a quarter to three quarters of the step between them: noise counts as neither.
    share = np.clip(2 * (volume - low) / (high - low) - 0.5, 0, 1).astype(np.float32)
    paths = projector(share)
    hardening = Hardening(*known, [base, dense], energy, float(paths.max()))
    return np.stack([hardening.correct(*view) for view in zip(integrals, paths, strict=True)])


def check_hardening(scenario: Scenario) -> None:
    """Look at what the correction needs, before any work.

    Raises:
        InputError: unknown materials, each with its key, or a dense one that attenuates less.
    """
    section = scenario.reconstruction.beam_hardening
    if section is None:
        return
    materials = _materials(section)
    if section.kind == "two_materials":
        energy = effective_energy(scenario)
        base, dense = (substance.mu_per_mm(energy) for substance in materials)
        if dense <= base:
            raise InputError(
                f"{_KEY}.dense: {materials[1].name} attenuates by {dense:.3g}/mm at {energy:.4g} "
                f"keV, {_KEY}.base: {materials[0].name} by {base:.3g}/mm: dense must exceed base"
            )


def _materials(section: BeamHardening) -> list[Material]:
    """Those that the section names: none, one, or base and dense."""
    from twinct.specimen.materials import material

    names = ("material",) if section.kind == "one_material" else ("base", "dense")
    found: list[Material] = []
    problems: list[str] = []
    for name in names:
        if (described := getattr(section, name)) is not None:
            try:
                found.append(material(described, f"{_KEY}.{name}"))
            except InputError as error:
                problems += error.problems
    if problems:
        raise InputError(problems)
    return found


def effective_energy(scenario: Scenario) -> float:
    """Photon energy at which attenuation is stated, keV: the mean one that the detector sees."""
    if scenario.source.spectrum is None:
        return scenario.source.energy_kev
    from twinct.xray.build import effective_energy_kev

    return effective_energy_kev(scenario.source, scenario.detector)
