"""Beams of a focal spot through a rectangular field."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.core.errors import InputError
from twinct.geometry import Floats, ScanGeometry
from twinct.transport.cross_sections import require_energies


@dataclass(frozen=True, eq=False)
class Beam:
    """Photons of a point source, isotropic within the solid angle of a rectangle.

    Attributes:
        source: focal spot, mm, (3,).
        centre: centre of the rectangle, mm, (3,).
        u: vector from the centre to the middle of an edge, mm, (3,).
        v: the other one, orthogonal to ``u``, mm, (3,).
        energies_kev: lines of the spectrum, keV, (lines,).
        photons: relative number of photons of each line, (lines,).
        profile: factor on the photons of each line and solid angle by place on the rectangle,
            (lines, places along v, places along u), from edge to edge and linear between places;
            without elements, it is 1.
    """

    source: Floats
    centre: Floats
    u: Floats
    v: Floats
    energies_kev: NDArray[np.float64]
    photons: NDArray[np.float64]
    profile: NDArray[np.float64]

    def __init__(
        self,
        source: ArrayLike,
        centre: ArrayLike,
        u: ArrayLike,
        v: ArrayLike,
        energies_kev: ArrayLike,
        photons: ArrayLike = 1.0,
        profile: ArrayLike | None = None,
    ) -> None:
        """Check and freeze the arrays.

        Raises:
            InputError: energies outside the tables, no photons, a profile that does not fit, or a
                field that the source does not see.
        """
        for name, value in (("source", source), ("centre", centre), ("u", u), ("v", v)):
            array = np.array(value, dtype=np.float64)
            if array.shape != (3,) or not np.isfinite(array).all():
                raise InputError(f"beam, {name}: must be three finite numbers in mm, got {value}")
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        energies = np.array(energies_kev, dtype=np.float64, ndmin=1)
        number = np.array(np.broadcast_to(np.asarray(photons, np.float64), energies.shape))
        require_energies(energies, "beam")
        if not (np.isfinite(number).all() and (number >= 0).all() and number.sum() > 0):
            raise InputError("beam: numbers of photons must be finite, at least 0, and not all 0")
        object.__setattr__(self, "energies_kev", energies)
        object.__setattr__(self, "photons", number)
        factors = np.zeros((0, 0, 0)) if profile is None else np.array(profile, np.float64)
        places = factors.ndim == 3 and min(factors.shape[1:]) > 1
        if profile is not None and not (places and len(factors) == len(energies)):
            raise InputError(
                f"beam: a profile of {factors.shape} for {len(energies)} lines; it needs factors "
                "for each line at two places at least along v and u"
            )
        if not (np.isfinite(factors).all() and (factors >= 0).all()):
            raise InputError("beam: factors of the profile must be finite and at least 0")
        factors.setflags(write=False)
        object.__setattr__(self, "profile", factors)
        if abs(self.u @ self.v) > 1e-6 * np.linalg.norm(self.u) * np.linalg.norm(self.v):
            raise InputError("beam: u and v of the field must be orthogonal")
        if not self.distance > 0:
            raise InputError(
                "beam: the source lies in the plane of the field, or the field is flat"
            )

    @classmethod
    def of_view(
        cls,
        geometry: ScanGeometry,
        view: int,
        energies_kev: ArrayLike,
        photons: ArrayLike = 1.0,
        profile: ArrayLike | None = None,
    ) -> Beam:
        """Return the beam of a view that covers just the panel."""
        width, height = geometry.panel.size_mm
        u, v = geometry.u[view] * width / 2, geometry.v[view] * height / 2
        centre = geometry.detector[view]
        return cls(geometry.source[view], centre, u, v, energies_kev, photons, profile)

    @property
    def normal(self) -> Floats:
        """Unit normal of the field, away from the source."""
        normal = np.cross(self.u, self.v)
        normal = normal / max(float(np.linalg.norm(normal)), 1e-300)
        return normal * np.sign(normal @ (self.centre - self.source))

    @property
    def distance(self) -> float:
        """Distance from the source to the field's plane, mm."""
        return float(self.normal @ (self.centre - self.source))

    @property
    def solid_angle(self) -> float:
        """Solid angle of the field, sr, by the formula of a rectangle from one of its corners."""
        widths, heights = self._ranges()
        d = self.distance
        corner = [
            [np.arctan2(x * y, d * np.sqrt(x * x + y * y + d * d)) for x in widths] for y in heights
        ]
        return float(corner[1][1] - corner[1][0] - corner[0][1] + corner[0][0])

    def _ranges(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Return the ranges of the field along u and v, from the source's foot, mm."""
        sizes = (float(np.linalg.norm(self.u)), float(np.linalg.norm(self.v)))
        middle = [
            float((self.centre - self.source) @ axis) / size
            for axis, size in zip((self.u, self.v), sizes, strict=True)
        ]
        (a, b) = ((m - s, m + s) for m, s in zip(middle, sizes, strict=True))
        return a, b

    @property
    def shortest(self) -> float:
        """Distance from the source to the nearest point of the field, mm."""
        off = [max(low, -high, 0.0) for low, high in self._ranges()]
        return float(np.sqrt(off[0] ** 2 + off[1] ** 2 + self.distance**2))

    @property
    def share(self) -> float:
        """Photons in the field, relative to those without a profile."""
        if not self.profile.size:
            return 1.0
        number = self.photons / self.photons.sum()
        together = np.tensordot(number, self.profile, axes=1)
        # Bilinear between places; the solid angle of a cell's parts, by their middles.
        parts = 8
        b, a = ((np.arange((n - 1) * parts) + 0.5) / parts for n in together.shape)
        along_v, along_u = (
            2 * t / (n - 1) - 1 for t, n in zip((b, a), together.shape, strict=True)
        )
        points = self.centre - self.source + along_u[:, None] * self.u
        points = points + along_v[:, None, None] * self.v
        weight = np.linalg.norm(points, axis=-1) ** -3.0
        rows, columns = (_hats(t, n) for t, n in zip((b, a), together.shape, strict=True))
        return float(((rows @ together @ columns.T) * weight).sum() / weight.sum())

    @property
    def cumulative(self) -> NDArray[np.float64]:
        """Share of photons up to each line, rising to 1, (lines,)."""
        total = np.cumsum(self.photons)
        return total / total[-1]


def _hats(places: Floats, nodes: int) -> Floats:
    """Return the weights of nodes 0, 1, ... at places between them, (places, nodes)."""
    return np.maximum(1 - np.abs(places[:, None] - np.arange(nodes)), 0.0)
