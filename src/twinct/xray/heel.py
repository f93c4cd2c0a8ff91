"""Heel effect: fewer and harder photons towards the anode, in which they travel farther."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy

from twinct.core.errors import InputError
from twinct.geometry import Floats
from twinct.xray.tube import tube_spectrum

Side = Literal["+u", "-u", "+v", "-v"]

_STEP = 0.025
"""Step of the tangents at which SpekPy is asked; interpolation errs by less than 0.1 %."""


@dataclass(frozen=True)
class HeelEffect:
    """Tube whose anode lies on one side of the panel.

    Attributes:
        kvp: tube voltage, kV.
        anode_angle_deg: angle between the anode's face and the central ray.
        target: W, Mo or Rh.
        side: direction on the panel of the anode's side.
    """

    kvp: float
    anode_angle_deg: float
    target: str
    side: Side

    def factors(self, energies_kev: Floats, tangents: Floats) -> Floats:
        """Return the photons of each energy relative to those of the central ray.

        Args:
            energies_kev: photon energies, (energies,).
            tangents: tangent of the angle to the central ray, towards the anode, (...).

        Returns:
            (energies, ...); per unit of solid angle.

        Raises:
            InputError: a ray leaves the anode along its face, where there are no photons.
        """
        limit = float(np.tan(np.radians(self.anode_angle_deg)))
        if tangents.max(initial=0.0) >= limit:
            reached = np.degrees(np.arctan(tangents.max()))
            raise InputError(
                f"source.spectrum.anode_side: the panel reaches {reached:.3g} deg from the central "
                f"ray towards the anode, whose face ends the beam at {self.anode_angle_deg:g} deg; "
                "take a larger anode_angle_deg or a larger distance"
            )
        first, last = (int(np.floor(tangents.min() / _STEP)), int(np.ceil(tangents.max() / _STEP)))
        nodes = np.append(np.arange(first - 1, last + 2) * _STEP, limit)
        nodes = np.unique(nodes[nodes <= limit])
        middle = self._spectrum(0.0, energies_kev)
        ratios = np.array([self._spectrum(node, energies_kev) for node in nodes.tolist()])
        ratios *= (1 + nodes[:, None] ** 2) / np.where(middle > 0, middle, 1.0)
        between = scipy.interpolate.PchipInterpolator(nodes, ratios)
        return np.moveaxis(np.maximum(between(tangents), 0.0), -1, 0)

    def _spectrum(self, tangent: float, energies_kev: Floats) -> Floats:
        if tangent >= np.tan(np.radians(self.anode_angle_deg)):
            return np.zeros_like(energies_kev)
        tube = tube_spectrum(self.kvp, self.anode_angle_deg, target=self.target, towards=tangent)
        energies, photons = tube.energies_kev, tube.photons
        return np.interp(energies_kev, energies, photons, left=0.0, right=0.0)
