"""Beam hardening correction of a scan's line integrals, as its scenario states."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.recon.checks import masked_image
from twinct.recon.memory import SPARE_BYTES
from twinct.recon.projector import Projector
from twinct.recon.sart import sart
from twinct.scan import SimulationBuilder, scenario_in
from twinct.scenario import BeamHardening
from twinct.scenario.imported import ScanSettings, beam_of
from twinct.specimen.materials import material
from twinct.xray.build import build_response, build_spectrum, effective_energy_kev
from twinct.xray.hardening import Hardening

if TYPE_CHECKING:
    from twinct.specimen.materials import Material
    from twinct.xray.hardening import Hardening

RELAXATION = 0.3
"""Relaxation of the first volume if the algorithm has no relaxation of its own."""

_KEY = "reconstruction.beam_hardening"


def hardening_corrected(
    settings: ScanSettings,
    integrals: NDArray[np.float32],
    A: Projector,
    mask: NDArray[np.bool_] | None = None,
) -> NDArray[np.float32]:
    """Return line integrals corrected for beam hardening, or unchanged without such a section.

    Line integrals are (views, rows, columns); the mask may lack the views. Only the correction for
    two materials, which reconstructs a first volume, uses ``A`` and the mask.
    """
    section = settings.reconstruction.beam_hardening
    if section is None:
        return integrals
    source, detector = beam_of(settings, _KEY), settings.detector
    energy = effective_energy_kev(source, detector)
    known = build_spectrum(source), build_response(detector)
    materials = materials_of(section)
    if section.kind == "one_material":
        substances = materials or [main_material(settings)]
        return _each(Hardening(*known, substances, energy), integrals)

    base = materials[0]
    volume = sart(
        A,
        _each(Hardening(*known, [base], energy), integrals),
        iterations=section.first_iterations,
        relaxation=getattr(settings.reconstruction, "relaxation", RELAXATION),
        mask=mask,
    ).array
    return corrected_for(settings, integrals, A, volume, mask)[0]


def main_material(settings: ScanSettings) -> Material:
    """Return the material of the specimen's largest part.

    Raises:
        InputError: an imported scan has no known specimen.
    """
    try:
        scenario = scenario_in(settings)
    except InputError:
        raise InputError(
            f"{_KEY}.material: name it, as the object of this scan is not known"
        ) from None
    return SimulationBuilder(scenario).specimen.largest_part.bulk


def corrected_for(
    settings: ScanSettings,
    integrals: NDArray[np.float32],
    A: Projector,
    volume: NDArray[np.float32],
    mask: NDArray[np.bool_] | None = None,
    *,
    keep: bool = False,
) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
    """Return line integrals corrected for two materials, which a volume separates by attenuation.

    The volume is (z, y, x). With ``keep``, also return the path lengths in the dense material,
    (views, rows, columns), mm.
    """
    section = settings.reconstruction.beam_hardening
    assert section is not None
    source, detector = beam_of(settings, _KEY), settings.detector
    energy = effective_energy_kev(source, detector)
    base, dense = materials_of(section)
    low, high = base.mu_per_mm(energy), dense.mu_per_mm(energy)
    share = np.empty_like(volume)
    for plane, values in zip(share, volume, strict=True):
        # It rises from 0 at 1/4 of the step to 1 at 3/4, so that small noise does not change it.
        plane[:] = np.clip(2 * (values - low) / (high - low) - 0.5, 0, 1)
    paths = A(share)
    known = build_spectrum(source), build_response(detector)
    hardening = Hardening(*known, [base, dense], energy, float(paths.max()))
    corrected = np.empty_like(paths) if keep else paths
    for view, path in enumerate(paths):
        corrected[view] = hardening.correct(masked_image(integrals, view, mask), path)
    return corrected, paths if keep else None


def _each(hardening: Hardening, integrals: NDArray[np.float32]) -> NDArray[np.float32]:
    """Correct one view at a time to save memory: the table look-up works in float64."""
    corrected = np.empty_like(integrals)
    for image, given in zip(corrected, integrals, strict=True):
        image[:] = hardening.correct(given)
    return corrected


def hardening_bytes(section: BeamHardening, voxels: int, pixels: int) -> int:
    """Return the bytes that ``hardening_corrected`` allocates; ``pixels`` counts all views."""
    volumes = 0 if section.kind == "one_material" else 2
    return 4 * (pixels + volumes * voxels) + SPARE_BYTES


def check_hardening(settings: ScanSettings) -> None:
    """Check the materials of the correction before any work.

    Raises:
        InputError: unknown materials, each with its key; or a dense material that does not
            attenuate more than the base material.
    """
    section = settings.reconstruction.beam_hardening
    if section is None:
        return
    materials = materials_of(section)
    if section.kind == "two_materials":
        energy = effective_energy_kev(beam_of(settings, _KEY), settings.detector)
        base, dense = (substance.mu_per_mm(energy) for substance in materials)
        if dense <= base:
            raise InputError(
                f"{_KEY}.dense: {materials[1].name} attenuates by {dense:.3g}/mm at {energy:.4g} "
                f"keV, {_KEY}.base: {materials[0].name} by {base:.3g}/mm: dense must exceed base"
            )


def materials_of(section: BeamHardening) -> list[Material]:
    """Return the materials that the section names: none, one, or base and dense."""
    names = ("material",) if section.kind == "one_material" else ("base", "dense")
    materials: list[Material] = []
    problems: list[str] = []
    for name in names:
        if (described := getattr(section, name)) is not None:
            try:
                materials.append(material(described, f"{_KEY}.{name}"))
            except InputError as error:
                problems += error.problems
    if problems:
        raise InputError(problems)
    return materials
