"""Metal artefact reduction of a scan: line integrals without metal, as its scenario states."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.recon.metal import WithoutMetal, without_metal
from twinct.recon.projector import Projector
from twinct.recon.steps import Callback
from twinct.scenario import Nmar, Scenario

_KEY = "reconstruction.metal"


def metal_replaced(
    scenario: Scenario,
    section: Nmar,
    integrals: NDArray[np.float32],
    A: Projector,
    mask: NDArray[np.bool_] | None,
    callback: Callback,
) -> WithoutMetal:
    """Return line integrals without metal, (views, rows, columns), and the metal's voxels.

    Raises:
        InputError: see ``without_metal``, with the key.
    """
    try:
        return without_metal(
            A,
            integrals,
            **_attenuations(scenario, section),
            threshold=section.threshold_per_mm,
            first_iterations=section.first_iterations,
            mask=mask,
            callback=callback,
        )
    except InputError as error:
        raise InputError(f"{_KEY}: {one}" for one in error.problems) from None


def none_found(metal: WithoutMetal) -> str | None:
    """Return a message if no metal was detected, else None."""
    if metal.voxels.size:
        return None
    return (
        f"{_KEY}: no metal was found and nothing replaced: the densest voxel of the first volume "
        f"attenuates by {metal.densest:.3g} per mm, but metal needs at least "
        f"{metal.threshold:.3g} ({_KEY}.threshold_per_mm)"
    )


def check_metal(scenario: Scenario) -> None:
    """Check the materials of the reduction before any work.

    Raises:
        InputError: unknown materials, each with its key, or attenuations that do not rise from
            tissue to metal.
    """
    section = scenario.reconstruction.metal
    if not isinstance(section, Nmar):
        return
    mus = _attenuations(scenario, section)
    if not mus["tissue"] < mus["bone"] < mus["metal"]:
        told = ", ".join(f"{name} {mu:.3g}" for name, mu in mus.items())
        raise InputError(f"{_KEY}: attenuation must rise from tissue to metal; got {told} per mm")


def _attenuations(scenario: Scenario, section: Nmar) -> dict[str, float]:
    """Return the attenuation of tissue, bone and metal at the detected mean energy, 1/mm."""
    from twinct.specimen.materials import material
    from twinct.xray.build import effective_energy_kev

    energy = effective_energy_kev(scenario.source, scenario.detector)
    found: dict[str, float] = {}
    problems: list[str] = []
    for name in ("tissue", "bone", "metal"):
        try:
            found[name] = material(getattr(section, name), f"{_KEY}.{name}").mu_per_mm(energy)
        except InputError as error:
            problems += error.problems
    if problems:
        raise InputError(problems)
    return found
