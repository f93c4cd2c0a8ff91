"""Response of a detector: mean and mean square of a photon's signal, by energy.

The mean gives the image, the mean square its quantum noise: a sum over a Poisson number of photons,
each with signal q, has the variance N E[q^2].
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from twinct.core.errors import InputError
from twinct.core.files.tables import read_columns
from twinct.geometry import Floats
from twinct.specimen.materials import Material
from twinct.xray.spectrum import attenuation


@dataclass(frozen=True)
class PhotonResponse:
    """Signal of one photon that reaches the detector.

    Attributes:
        name: name for messages.
        mean: function from energies in keV to the mean signal of a photon, in ``unit``.
        square: function from energies in keV to the mean square of the signal.
        unit: ``photons`` or ``keV``.
        range_kev: range of the table; beyond its ends, the first and last share apply.
    """

    name: str
    mean: Callable[[Floats], Floats]
    square: Callable[[Floats], Floats]
    unit: str
    range_kev: tuple[float, float] = (0.0, math.inf)

    @classmethod
    def counting(cls) -> PhotonResponse:
        """Return ideal photon counting: one per photon."""
        return cls("counting", np.ones_like, np.ones_like, "photons")

    @classmethod
    def integrating(cls) -> PhotonResponse:
        """Return ideal energy integration: the full energy of each photon."""
        return cls("integrating", lambda e: np.asarray(e, dtype=float), np.square, "keV")

    @classmethod
    def scintillator(
        cls, material: Material, thickness_mm: float, swank: float = 1.0
    ) -> PhotonResponse:
        """Return a layer that absorbs attenuated photons with their full energy.

        A share 1 - exp(-mu t) of the photons is absorbed. Escaping fluorescence and scattered
        photons count as absorbed. The light of equal photons differs, which divides the mean square
        of their signal by ``swank``: see ``swank_factor``.
        """

        def share(energies: Floats) -> Floats:
            return -np.expm1(-attenuation(material, energies) * thickness_mm)

        return cls._absorbing(share, f"{thickness_mm:g} mm {material.name}", swank)

    @classmethod
    def efficiency(
        cls, energies_kev: Floats, shares: Floats, name: str = "efficiency"
    ) -> PhotonResponse:
        """Return the response of a tabulated share of photons, absorbed with their full energy."""
        return cls._absorbing(lambda e: np.interp(e, energies_kev, shares), name)

    @classmethod
    def _absorbing(
        cls, share: Callable[[Floats], Floats], name: str, swank: float = 1.0
    ) -> PhotonResponse:
        return cls(name, lambda e: share(e) * e, lambda e: share(e) * np.square(e) / swank, "keV")

    @classmethod
    def read_efficiency(cls, path: Path) -> PhotonResponse:
        """Read two columns of text: energy in keV, share of photons absorbed (0 to 1).

        Raises:
            InputError: the file holds no such table; names the file.
        """
        energies, shares = read_columns(path, 2)
        problems = []
        if (np.diff(energies) <= 0).any():
            problems.append(f"{path}: the energies must rise")
        if shares.min() < 0 or shares.max() > 1:
            wrong = shares.min() if shares.min() < 0 else shares.max()
            problems.append(f"{path}: a share is {wrong:g}; shares must lie between 0 and 1")
        if not shares.any():
            problems.append(f"{path}: the detector absorbs nothing: all shares are 0")
        if problems:
            raise InputError(problems)
        made = cls.efficiency(energies, shares, str(path))
        return replace(made, range_kev=(float(energies[0]), float(energies[-1])))

    def behind(self, material: Material, thickness_mm: float) -> PhotonResponse:
        """Return this detector behind a window or filter, crossed at right angles."""
        return self.passing(lambda e: np.exp(-attenuation(material, e) * thickness_mm))

    def passing(self, share: Callable[[Floats], Floats]) -> PhotonResponse:
        """Return this detector behind what lets a share of the photons of each energy pass."""
        return PhotonResponse(
            self.name,
            lambda e: share(e) * self.mean(e),
            lambda e: share(e) * self.square(e),
            self.unit,
            self.range_kev,
        )


def swank_factor(heights: ArrayLike, counts: ArrayLike) -> float:
    """Return the Swank factor of a pulse-height spectrum, M1^2 / (M0 M2) of its moments.

    Swank, J. Appl. Phys. 44 (1973) 4199.

    Args:
        heights: pulse heights, such as light photons of one absorbed X-ray photon.
        counts: number of pulses of each height.

    Raises:
        InputError: a number is negative, or there are no pulses.
    """
    height, count = np.broadcast_arrays(np.asarray(heights, float), np.asarray(counts, float))
    if not ((height >= 0).all() and (count >= 0).all() and (height * count).sum() > 0):
        raise InputError("pulse heights and their counts must be at least 0, and not all 0")
    moments = [float((count * height**n).sum()) for n in range(3)]
    return moments[1] ** 2 / (moments[0] * moments[2])
