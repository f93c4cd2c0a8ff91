"""Metal in the beam: path lengths in metal, beam hardening and photon starvation in a region.

Rays through metal cause streaks along their paths, because few photons remain and their spectrum
is changed. Views that see a region past the metal avoid both (P. Wu et al., Phys. Med. Biol. 65
(2020) 165012).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from twinct.core.errors import InputError
from twinct.core.settings import Conflict, Positive, Section, setting
from twinct.geometry import Floats, Pose, ScanGeometry
from twinct.rays import Body, Rays
from twinct.recon import Projector
from twinct.recon.volume import Volume
from twinct.specimen.materials import Material
from twinct.view_planning.objectives.measures import Mean
from twinct.view_planning.objectives.objective import (
    LessIsBetter,
    Objective,
    PatientModel,
    Views,
    unknown_parts,
)
from twinct.view_planning.objectives.visibility import sees

PIXEL_MM = 1.0
"""Pixel pitch at the panel; finer pixels are binned."""

MOST_POINTS = 200
"""Largest number of points of the metal in a volume."""


class SeenMetal(Section):
    """Metal that a volume shows, such as a volume from a few scout views."""

    path: Path = Field(
        description="NIfTI file of attenuation in 1/mm, in world coordinates, such as a run's "
        "volume.nii."
    )
    above_per_mm: Positive = setting(
        0.1, "Attenuation above which a voxel is metal; bone stays below it.", unit="1/mm"
    )
    material: str = setting("titanium", "Material of the metal, by name.")


class MetalGoal(LessIsBetter):
    """Metal that rays cross: less is better."""

    parts: tuple[str, ...] = setting((), "Names of the metal parts.")
    seen: SeenMetal | None = setting(None, "Metal that a volume shows, instead of parts.")
    counts: Literal["length", "starved", "shift"] = setting(
        "length",
        "Cost of a ray. length: its length in metal; starved: whether fewer than least_photons "
        "photons remain; shift: how much the metal hardens the beam along the ray.",
    )
    least_photons: Positive = setting(
        100.0, "Photons in a pixel below which a ray is starved.", unit="1"
    )
    rays: Literal["region", "metal"] = setting(
        "region",
        "Rays that count. region: those through the region; metal: those through the metal "
        "itself, if the surroundings of the metal are of interest.",
    )


def metal_paths(
    geometry: ScanGeometry, metal: Sequence[tuple[Body, Pose]], points: ArrayLike
) -> Floats:
    """Compute the mean path length in metal of each view's rays through a region, mm.

        sum over the points seen of l(ray of the pixel where the point projects) / their number

    Args:
        geometry: views; their pixels limit the resolution of the metal's edges, see ``binned``.
        metal: closed bodies that do not overlap, and ``world_from_body`` of each.
        points: points of the region, (points, 3), mm.

    Returns:
        (views,); NaN for a view that sees no point.

    Raises:
        InputError: metal reaches behind a source.
    """
    return mean_of_views([one.sum(axis=0) for one in metal_lengths(geometry, metal, points)])


def metal_lengths(
    geometry: ScanGeometry, metal: Sequence[tuple[Body, Pose]], points: ArrayLike
) -> list[Floats]:
    """Compute path lengths of each view's rays through points in each body.

    See ``metal_paths`` for the arguments.

    Returns:
        (bodies, points seen) of each view, mm.
    """
    images = np.empty((len(metal), *geometry.panel.shape))
    rays, lengths = Rays(geometry), []
    for view, (row, column) in enumerate(_pixels(geometry, points)):
        images[:] = 0.0
        for image, (body, world_from_body) in zip(images, metal, strict=True):
            shadow = rays.shadow(body, world_from_body, view)
            image[shadow.box] += shadow.lengths
        lengths.append(images[:, row, column])
    return lengths


def lengths_in_metal(A: Projector, metal: ArrayLike, points: ArrayLike) -> list[Floats]:
    """Compute path lengths in metal from a volume, such as a reconstruction of scout views.

    Args:
        A: projector of the views, on the volume's grid.
        metal: 1 in metal, 0 elsewhere, (z, y, x).
        points: points of the region, (points, 3), mm.

    Returns:
        (1, points seen) of each view, mm.
    """
    there = np.asarray(metal, np.float32)
    return [
        A[[view]](there)[0][row, column][None].astype(np.float64)
        for view, (row, column) in enumerate(_pixels(A.geometry, points))
    ]


def spectral_shift(lengths: ArrayLike, attenuation_per_mm: ArrayLike, photons: ArrayLike) -> Floats:
    """Compute the shortfall of line integrals by beam hardening, relative to thin metal.

        sum_E w_E d_E + ln(sum_E w_E exp(-d_E)),   d_E = sum over the bodies of mu_E l

    with the shares w_E of the photons, weighted by their signals. The shortfall is 0 for a single
    energy and for thin metal, and grows with the square of the path length at first. It causes the
    streaks between metal bodies (P. Wu et al., 2020).

    Args:
        lengths: path lengths in each body, (bodies, rays), mm.
        attenuation_per_mm: attenuation of each body at each energy, (bodies, energies), 1/mm.
        photons: photons at each energy, weighted by their signals, (energies,).

    Returns:
        (rays,), 0 or more.
    """
    depths = np.asarray(lengths, np.float64).T @ np.asarray(attenuation_per_mm, np.float64)
    share = np.asarray(photons, np.float64)
    share = share / share.sum()
    return depths @ share + scipy.special.logsumexp(-depths, b=share, axis=1)


def mean_of_views(values: Sequence[Floats]) -> Floats:
    """Return the mean over the rays of each view, (views,); NaN for a view without rays."""
    return np.array([one.mean() if one.size else np.nan for one in values])


def starved_share(
    geometry: ScanGeometry, photons: ArrayLike, points: ArrayLike, least: float
) -> Floats:
    """Return the share of each view's rays through a region with fewer than ``least`` photons.

    Args:
        geometry: views.
        photons: expected photons in each pixel, (views, rows, columns).
        points: points of the region, (points, 3), mm.
        least: least number of photons of a useful ray.

    Returns:
        (views,), 0 to 1; NaN for a view that sees no point.
    """
    photons = np.asarray(photons)
    return np.array(
        [
            (photons[view, row, column] < least).mean() if len(row) else np.nan
            for view, (row, column) in enumerate(_pixels(geometry, points))
        ]
    )


def _pixels(
    geometry: ScanGeometry, points: ArrayLike
) -> list[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Return for each view the rows and columns of the pixels of the points that it sees."""
    points = np.atleast_2d(np.asarray(points, dtype=np.float64))
    seen, places, panel = sees(geometry, points), geometry.project(points), geometry.panel
    pixels = []
    for view in range(len(geometry)):
        column, row = np.rint(places[view, seen[view]]).astype(np.intp).T
        inside = (np.clip(row, 0, panel.rows - 1), np.clip(column, 0, panel.columns - 1))
        pixels.append(inside)
    return pixels


@dataclass(frozen=True, eq=False)
class _Parts:
    """Metal parts of the specimen."""

    names: Sequence[str]
    patient: PatientModel

    def materials(self) -> list[Material]:
        """Return the material of each body."""
        return [self.patient.material_of(name) for name in self.names]

    def points(self) -> Floats:
        """Return points of the metal, (points, 3), mm."""
        return np.vstack([self.patient.points_of(name) for name in self.names])

    def lengths(self, geometry: ScanGeometry, points: Floats) -> list[Floats]:
        """Return path lengths in each body, (bodies, points seen) for each view."""
        return metal_lengths(geometry, [self.patient.body(name) for name in self.names], points)

    def dim(self, geometry: ScanGeometry, photons: Floats) -> Floats:
        """Return the photons behind metal that the patient's model lacks."""
        return photons


@dataclass(frozen=True, eq=False)
class _Seen:
    """Metal in a volume, one body; methods as in ``_Parts``."""

    section: SeenMetal
    patient: PatientModel
    volume: Volume
    there: NDArray[np.bool_]

    @classmethod
    def read(cls, section: SeenMetal, patient: PatientModel) -> _Seen:
        """Read the volume.

        Raises:
            InputError: an unreadable volume, or one without metal.
        """
        volume = Volume.read(section.path)
        there = volume.array > section.above_per_mm
        if not there.any():
            raise InputError(
                f"task.metal.seen.above_per_mm: no voxel of {section.path} is above "
                f"{section.above_per_mm:g} 1/mm: the largest is {float(volume.array.max()):.3g}"
            )
        return cls(section, patient, volume, there)

    def materials(self) -> list[Material]:
        return [self.patient.material(self.section.material, "task.metal.seen.material")]

    def points(self) -> Floats:
        grid, index = self.volume.grid, np.argwhere(self.there)[:, ::-1]
        some = np.random.default_rng(self.patient.seed).permutation(len(index))
        local = index[some[:MOST_POINTS]] * grid.voxel + grid.first_voxel_mm
        return grid.world_from_grid.apply(local)

    def lengths(self, geometry: ScanGeometry, points: Floats) -> list[Floats]:
        return lengths_in_metal(Projector(geometry, self.volume.grid), self.there, points)

    def dim(self, geometry: ScanGeometry, photons: Floats) -> Floats:
        mu_per_mm = self.materials()[0].mu_per_mm(self.patient.energy_kev)
        lengths = Projector(geometry, self.volume.grid)(self.there.astype(np.float32))
        return photons * np.exp(-mu_per_mm * lengths)


def _measure(settings: MetalGoal, views: Views, patient: PatientModel) -> Mean:
    """Return the mean effect of metal; the maximum for views that see no point."""
    panel, seen, points = views.geometry.panel, settings.seen, views.points
    metal = _Parts(settings.parts, patient) if seen is None else _Seen.read(seen, patient)
    materials = metal.materials()
    if settings.rays == "metal":
        points = metal.points()
    if settings.counts == "starved":
        coarse, photons = patient.photons(
            views.geometry, points[0], patient.voxel_mm, "task.metal.counts"
        )
        pixels = coarse.panel.pitch_u * coarse.panel.pitch_v / (panel.pitch_u * panel.pitch_v)
        least = settings.least_photons * pixels
        result = starved_share(coarse, metal.dim(coarse, photons), points, least)
        return _everywhere(result)
    factors = (max(1, int(PIXEL_MM / pitch)) for pitch in (panel.pitch_v, panel.pitch_u))
    lengths = metal.lengths(views.geometry.binned(*factors), points)
    if settings.counts == "length":
        return _everywhere(mean_of_views([one.sum(axis=0) for one in lengths]))
    energies, weights = patient.signals()
    if len(energies) < 2:
        raise InputError("task.metal.counts: shift: a single energy does not harden; use a tube")
    mu = [[one.mu_per_mm(energy) for energy in energies.tolist()] for one in materials]
    return _everywhere(mean_of_views([spectral_shift(one, mu, weights) for one in lengths]))


def _everywhere(shares: Floats) -> Mean:
    return Mean(np.nan_to_num(shares, nan=float(np.nanmax(shares))))


def _conflicts(settings: MetalGoal, parts: Sequence[str]) -> list[Conflict]:
    wanted = {f"task.metal.parts.{i}": name for i, name in enumerate(settings.parts)}
    unknown = unknown_parts(wanted, parts)
    if bool(settings.parts) == (settings.seen is not None):
        message = "task.metal: give either parts (of the specimen) or seen (in a volume)"
        unknown.insert(0, Conflict(message, ("task.metal.parts", "task.metal.seen")))
    return unknown


METAL = Objective(
    "metal",
    MetalGoal,
    _measure,
    "Avoid rays through metal.",
    unit=lambda own: "mm" if own.counts == "length" else "1",
    conflicts=_conflicts,
)
