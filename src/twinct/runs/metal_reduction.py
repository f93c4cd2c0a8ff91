"""Metal artefact reduction of a scan: line integrals without metal, as its scenario states."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.recon.metal import Excess, WithoutMetal, without_metal
from twinct.recon.projector import Projector
from twinct.recon.steps import Callback
from twinct.scan import Scan
from twinct.scan.integrals import line_integrals
from twinct.scenario import Nmar
from twinct.scenario.imported import ScanSettings, beam_of
from twinct.specimen.materials import material
from twinct.xray.build import build_response, build_spectrum, effective_energy_kev
from twinct.xray.hardening import Hardening

_KEY = "reconstruction.metal"


def metal_replaced(
    scan: Scan,
    section: Nmar,
    integrals: NDArray[np.float32],
    whole: NDArray[np.float32],
    A: Projector,
    mask: NDArray[np.bool_] | None,
    callback: Callback,
) -> WithoutMetal:
    """Return line integrals without metal, (views, rows, columns), and the metal.

    Args:
        scan: the images, and the scenario.
        section: its reduction of metal.
        integrals: corrected line integrals of what lies in the grid.
        whole: corrected line integrals of everything.
        A: the projector.
        mask: True where a pixel counts.
        callback: callback of the first volume.

    Raises:
        InputError: see ``without_metal``, with the key.
    """
    mus = _attenuations(scan.settings, section)
    try:
        return without_metal(
            A,
            integrals,
            **mus,
            fit=_excess(scan, section, whole, integrals, mus["tissue"]),
            threshold=section.threshold_per_mm,
            first_iterations=section.first_iterations,
            mask=mask,
            callback=callback,
        )
    except InputError as error:
        raise InputError(f"{_KEY}: {one}" for one in error.problems) from None


def _excess(
    scan: Scan,
    section: Nmar,
    whole: NDArray[np.float32],
    inner: NDArray[np.float32],
    tissue: float,
) -> Excess | bool:
    """Return the function that takes the metal's line integrals from polychromatic images.

    Everything else counts as a path in tissue that hardens the beam before the metal does.
    """
    source, detector = beam_of(scan.settings, _KEY), scan.settings.detector
    if source.spectrum is None:
        return True
    energy = effective_energy_kev(source, detector)
    known = build_spectrum(source), build_response(detector)
    metal, soft = material(section.metal), material(section.tissue)
    longest = float(whole.max()) / tissue
    of_both = Hardening(*known, [metal, soft], energy, longest)
    of_soft = Hardening(*known, [soft], energy)
    corrected = scan.settings.reconstruction.beam_hardening is not None

    def excess(view: int, given: NDArray[np.float32]) -> NDArray[np.float32]:
        rest = given + (whole[view] - inner[view])
        rest = rest if corrected else of_soft.correct(rest)
        measured = line_integrals(scan.transmission[view])
        return of_both.correct(measured, rest / np.float32(tissue)) - rest

    return excess


def doubts(metal: WithoutMetal) -> str | None:
    """Return a message if values of the metal are not quantitative or none was found; else None."""
    if metal.voxels.size and not metal.as_named:
        return (
            f"{_KEY}: the metal attenuates {metal.density_rel:.2f} times as much as the material "
            f"named ({_KEY}.metal), so it is another one or photons ran out: its values in the "
            "volume are not quantitative"
        )
    if metal.thin:
        return (
            f"{_KEY}: {metal.thin} of {metal.voxels.size} metal voxels lie in parts thinner than "
            "three voxels: their values in the volume are not quantitative; take smaller voxels "
            "(reconstruction.grid or reconstruction.zoom) to measure the density there"
        )
    if metal.voxels.size:
        return None
    return (
        f"{_KEY}: no metal was found and nothing replaced: the densest voxel of the first volume "
        f"attenuates by {metal.densest:.3g} per mm, but metal needs at least "
        f"{metal.threshold:.3g} ({_KEY}.threshold_per_mm)"
    )


def check_metal(settings: ScanSettings) -> None:
    """Check the materials of the reduction before any work.

    Raises:
        InputError: unknown materials, each with its key, or attenuations that do not rise from
            tissue to metal.
    """
    section = settings.reconstruction.metal
    if not isinstance(section, Nmar):
        return
    mus = _attenuations(settings, section)
    if not mus["tissue"] < mus["bone"] < mus["metal"]:
        text = ", ".join(f"{name} {mu:.3g}" for name, mu in mus.items())
        raise InputError(f"{_KEY}: attenuation must rise from tissue to metal; got {text} per mm")


def _attenuations(settings: ScanSettings, section: Nmar) -> dict[str, float]:
    """Return the attenuation of tissue, bone and metal at the detected mean energy, 1/mm."""
    energy = effective_energy_kev(beam_of(settings, _KEY), settings.detector)
    attenuations: dict[str, float] = {}
    problems: list[str] = []
    for name in ("tissue", "bone", "metal"):
        try:
            attenuations[name] = material(getattr(section, name), f"{_KEY}.{name}").mu_per_mm(
                energy
            )
        except InputError as error:
            problems += error.problems
    if problems:
        raise InputError(problems)
    return attenuations
