"""Keys, positions and panel axes that the families about an isocentre share."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from twinct.core.errors import TrajectoryError
from twinct.core.settings import Conflict, ConflictError, Finite, Length, Vector, setting
from twinct.geometry import Floats, Panel, ScanGeometry
from twinct.trajectory.family import TrajectorySettings

_STEEPEST_BEAM = 1e-9
"""Smallest horizontal component of a beam's direction that still defines the horizontal axis."""


Course = Annotated[tuple[Length, ...], Field(min_length=2, max_length=10_000)]
"""Distance that varies along the path: values at equal shares of the path, linear in between."""


class OrbitSettings(TrajectorySettings):
    """Keys of all families about an isocentre."""

    views: int = Field(ge=1, le=100_000, description="Number of projections.")
    isocentre_mm: Vector = setting((0.0, 0.0, 0.0), "Centre of the orbit.")
    sod_mm: Length | Course = setting(
        300.0,
        "Distance from source to isocentre; or several distances, spaced equally along the path "
        "and interpolated linearly.",
        source="the paper",
    )
    sdd_mm: Length | Course = setting(
        600.0,
        "Distance from source to panel centre; or several, as for sod_mm.",
        source="the paper, as docs/paper.md reads it",
    )
    centre_longitude_deg: Finite = setting(
        0.0, "Longitude of the source in the middle of the path; 0 is +x, 90 is +y."
    )

    @model_validator(mode="after")
    def _isocentre_between(self) -> OrbitSettings:
        share = np.unique(np.concatenate([_knots(self.sod_mm), _knots(self.sdd_mm)]))
        sod, sdd = self.sod_at(share), self.sdd_at(share)
        if (sdd <= sod).any():
            worst = int((sdd - sod).argmin())
            wrong = f"sdd_mm ({sdd[worst]:g}) must exceed sod_mm ({sod[worst]:g})"
            message = f"{wrong}: the isocentre lies between source and panel"
            raise ConflictError(Conflict(message, ("sdd_mm", "sod_mm")))
        return self

    def sod_at(self, share: ArrayLike) -> Floats:
        """Return the SOD at shares of the path, 0 to 1, mm."""
        return _course(self.sod_mm, share)

    def sdd_at(self, share: ArrayLike) -> Floats:
        """Return the distances from source to panel centre at shares of the path, 0 to 1, mm."""
        return _course(self.sdd_mm, share)


def orbit_views(
    section: OrbitSettings,
    panel: Panel,
    sources: Floats,
    centres: Floats | None = None,
    share: Floats | None = None,
) -> ScanGeometry:
    """Return the views along a path of the source.

    The panel is orthogonal to the beam through the isocentre, u horizontal, v upwards.

    Args:
        section: distances and isocentre.
        panel: the pixel lattice.
        sources: positions at ``sod_at(share)`` from their centres, (views, 3), mm.
        centres: points on the beams, (views, 3), mm; by default the isocentre. Sources and centres
            are both shifted by ``isocentre_mm``.
        share: share of the path at each view, 0 to 1, (views,); by default ``stops``.
    """
    centres = np.zeros_like(sources) if centres is None else centres
    share = stops(len(sources)) if share is None else share
    sod, sdd = section.sod_at(share)[:, None], section.sdd_at(share)[:, None]
    directions = (sources - centres) / sod
    detectors = centres - (sdd - sod) * directions
    u, v = panel_axes(directions)
    shift = np.asarray(section.isocentre_mm)
    return ScanGeometry(sources + shift, detectors + shift, u, v, panel)


def panel_axes(towards_source: Floats) -> tuple[Floats, Floats]:
    """Return the axes of a panel that faces the source: u horizontal, v = n x u upwards.

    Args:
        towards_source: unit normals n, (views, 3).

    Raises:
        TrajectoryError: a beam is vertical, so that every u is horizontal.
    """
    u = np.cross([0.0, 0.0, 1.0], towards_source)
    length = np.linalg.norm(u, axis=1)
    if (length < _STEEPEST_BEAM).any():
        raise TrajectoryError(
            f"view {int((length < _STEEPEST_BEAM).argmax())}: the beam is vertical, so the "
            "horizontal panel axis is undefined; give u and v in a file of views"
        )
    u /= length[:, None]
    v = np.cross(towards_source, u)
    return u, v / np.linalg.norm(v, axis=1)[:, None]


def on_sphere(longitude: Floats, latitude: Floats, radius: ArrayLike = 1.0) -> Floats:
    """Return points (..., 3) at longitudes and latitudes in rad, with one radius or one each."""
    cos = np.cos(latitude)
    points = [cos * np.cos(longitude), cos * np.sin(longitude), np.sin(latitude)]
    return np.asarray(radius)[..., None] * np.stack(points, axis=-1)


def stops(views: int) -> Floats:
    """Return the shares of the path at which views are taken; a single view is in the middle."""
    return np.linspace(0.0, 1.0, views) if views > 1 else np.array([0.5])


def _knots(distance: float | tuple[float, ...]) -> Floats:
    return np.linspace(0.0, 1.0, len(distance)) if isinstance(distance, tuple) else np.zeros(1)


def _course(distance: float | tuple[float, ...], share: ArrayLike) -> Floats:
    if not isinstance(distance, tuple):
        return np.full(np.shape(share), distance)
    return np.interp(np.asarray(share, dtype=np.float64), _knots(distance), distance)
