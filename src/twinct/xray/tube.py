"""Spectrum of an X-ray tube, by SpekPy; no other module calls SpekPy."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from twinct.core.errors import InputError, MissingExtraError
from twinct.xray.spectrum import PhotonSpectrum

_CM2_MM2 = 100.0


@lru_cache(maxsize=128)  # SpekPy takes up to a second, and several places call it
def tube_spectrum(
    kvp: float,
    anode_angle_deg: float = 12.0,
    *,
    step_kev: float = 1.0,
    target: str = "W",
    towards: float = 0.0,
) -> PhotonSpectrum:
    """Return a tube's unfiltered spectrum on the central ray, or on one towards the anode.

    SpekPy's model (Poludniowski et al., Med. Phys. 48 (2021) 3630) with its default physics
    (``casim``), per mAs and mm^2 at 1 m.

    Args:
        kvp: tube voltage, kV.
        anode_angle_deg: angle between the anode's face and the central ray.
        step_kev: width of a bin.
        target: W, Mo or Rh.
        towards: tangent of the angle to the central ray, towards the anode. The spectrum is that on
            a plane across the central ray, at 1 m along it.

    Raises:
        InputError: the arguments are outside SpekPy's range.
        MissingExtraError: SpekPy is not installed.
    """
    try:
        import spekpy
    except ImportError as error:
        raise MissingExtraError("spekpy", "xray") from error
    try:
        # SpekPy's x is in cm and negative towards the anode.
        across = -100.0 * towards
        tube = spekpy.Spek(
            kvp=kvp, th=anode_angle_deg, dk=step_kev, mas=1.0, x=across, z=100.0, targ=target
        )
        energies, per_cm2 = tube.get_spectrum(diff=False)
    except Exception as error:  # SpekPy raises Exception itself
        raise InputError(
            f"no tube spectrum for {kvp:g} kV, {anode_angle_deg:g} deg, target {target}: {error}"
        ) from None
    return PhotonSpectrum(np.asarray(energies), np.asarray(per_cm2) / _CM2_MM2)
