"""What a detector makes of a photon: the mean and the mean square of its signal, by energy.

The mean gives the image, the mean square its quantum noise: a sum over a Poisson number of photons,
each with signal q, has the variance N E[q^2].
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twinct.errors import InputError
from twinct.geometry import Floats
from twinct.specimen.materials import Material
from twinct.xray.spectrum import attenuation, read_columns


@dataclass(frozen=True)
class Response:
    """Signal of one photon that meets the detector.

    Attributes:
        name: for messages.
        mean: energies in keV to the mean signal of a photon, in ``unit``.
        square: energies in keV to the mean square of it.
        unit: ``photons`` or ``keV``.
    """

    name: str
    mean: Callable[[Floats], Floats]
    square: Callable[[Floats], Floats]
    unit: str

    @classmethod
    def counting(cls) -> Response:
        """Ideal photon counting: one for each photon."""
        return cls("counting", np.ones_like, np.ones_like, "photons")

    @classmethod
    def integrating(cls) -> Response:
        """Ideal energy integration: all of a photon's energy."""
        return cls("integrating", lambda e: np.asarray(e, dtype=float), np.square, "keV")

    @classmethod
    def scintillator(cls, material: Material, thickness_mm: float) -> Response:
        """A layer that absorbs the photons it attenuates, with all of their energy.

        A share 1 - exp(-mu t) of the photons is absorbed. Fluorescence and scattered photons that
        escape are counted as absorbed.
        """

        def share(energies: Floats) -> Floats:
            return -np.expm1(-attenuation(material, energies) * thickness_mm)

        return cls(
            f"{thickness_mm:g} mm {material.name}",
            lambda e: share(e) * e,
            lambda e: share(e) * e**2,
            "keV",
        )

    @classmethod
    def efficiency(cls, energies_kev: Floats, shares: Floats, name: str = "efficiency") -> Response:
        """A tabulated share of absorbed photons, each with all of its energy; linear between."""
        return cls(
            name,
            lambda e: np.interp(e, energies_kev, shares) * e,
            lambda e: np.interp(e, energies_kev, shares) * np.square(e),
            "keV",
        )

    @classmethod
    def read_efficiency(cls, path: Path) -> Response:
        """Two columns of text: energy in keV, share of photons absorbed (0 to 1).

        Raises:
            InputError: not such a table; names the file.
        """
        energies, shares = read_columns(path, 2)
        if (np.diff(energies) <= 0).any() or (shares < 0).any() or (shares > 1).any():
            raise InputError(f"{path}: energies must rise, and shares lie between 0 and 1")
        return cls.efficiency(energies, shares, str(path))

    def behind(self, material: Material, thickness_mm: float) -> Response:
        """The same detector behind a window or filter, crossed at right angles."""

        def passed(energies: Floats) -> Floats:
            return np.exp(-attenuation(material, energies) * thickness_mm)

        return Response(
            self.name,
            lambda e: passed(e) * self.mean(e),
            lambda e: passed(e) * self.square(e),
            self.unit,
        )
