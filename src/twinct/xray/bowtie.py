"""Bowtie filter: a plate on the source's side, thicker towards the edges of the fan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from twinct.geometry import Floats
from twinct.specimen.materials import Material
from twinct.xray.spectrum import attenuation


@dataclass(frozen=True, eq=False)
class Bowtie:
    """Filter whose thickness depends on the fan angle, and is constant across the fan.

    Attributes:
        material: its material.
        angles_deg: fan angles, rising from 0, (n,); the filter is symmetric.
        thickness_mm: length of the ray through the filter at each of them, (n,), mm; linear between
            them, constant beyond the last.
        along: axis of the panel along which the fan opens.
    """

    material: Material
    angles_deg: Floats
    thickness_mm: Floats
    along: Literal["u", "v"]

    def lengths(self, across: Floats, along: Floats) -> Floats:
        """Return the lengths of rays through the filter, mm.

        Args:
            across: tangent of the angle to the central ray across the fan.
            along: the tangent in the fan.
        """
        fan = np.degrees(np.abs(np.arctan(along)))
        thickness = np.interp(fan, self.angles_deg, self.thickness_mm)
        return thickness * np.sqrt(1 + across**2 / (1 + along**2))

    def factors(self, energies_kev: Floats, across: Floats, along: Floats) -> Floats:
        """Return the photons of each energy relative to those of the central ray, (energies, ...).

        See ``lengths`` for the other arguments.
        """
        more = self.lengths(across, along) - self.thickness_mm[0]
        return np.exp(-np.multiply.outer(attenuation(self.material, energies_kev), more))
