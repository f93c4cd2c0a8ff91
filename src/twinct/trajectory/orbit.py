"""What the families about an isocentre share: keys, positions on a sphere, an upright panel."""

from __future__ import annotations

import numpy as np
from pydantic import Field, model_validator

from twinct.errors import TrajectoryError
from twinct.geometry import Floats, Panel, ScanGeometry
from twinct.settings import Conflict, ConflictError, Finite, Positive, Vector, setting
from twinct.trajectory.family import TrajectorySettings

_STEEPEST_BEAM = 1e-9
"""Smallest horizontal share of a beam that still tells which way is horizontal."""


class OrbitSettings(TrajectorySettings):
    """Keys of all families about an isocentre."""

    views: int = Field(ge=1, le=100_000, description="Number of projections.")
    isocentre_mm: Vector = setting((0.0, 0.0, 0.0), "Centre of the orbit.")
    sod_mm: Positive = setting(300.0, "Distance from source to isocentre.", source="the paper")
    sdd_mm: Positive = setting(
        600.0,
        "Distance from source to panel centre.",
        source="the paper, as docs/paper.md reads it",
    )
    centre_longitude_deg: Finite = setting(
        0.0, "Longitude of the source in the middle of the path; 0 is +x, 90 is +y."
    )

    @model_validator(mode="after")
    def _isocentre_between(self) -> OrbitSettings:
        if self.sdd_mm <= self.sod_mm:
            wrong = f"sdd_mm ({self.sdd_mm:g}) must exceed sod_mm ({self.sod_mm:g})"
            message = f"{wrong}: the isocentre lies between source and panel"
            raise ConflictError(Conflict(message, ("sdd_mm", "sod_mm")))
        return self


def orbit_views(
    section: OrbitSettings, panel: Panel, sources: Floats, centres: Floats | None = None
) -> ScanGeometry:
    """The views of a path of the source.

    The panel stands orthogonal to the beam through the isocentre, u horizontal, v upwards.

    Args:
        section: distances, and where the isocentre is.
        panel: the pixel lattice.
        sources: positions at ``sod_mm`` from their centres, (views, 3), mm.
        centres: what the beams go through, (views, 3), mm; without them the isocentre. Both are
            moved by ``isocentre_mm``.
    """
    centres = np.zeros_like(sources) if centres is None else centres
    directions = (sources - centres) / section.sod_mm
    detectors = centres - (section.sdd_mm - section.sod_mm) * directions
    u, v = panel_axes(directions)
    shift = np.asarray(section.isocentre_mm)
    return ScanGeometry(sources + shift, detectors + shift, u, v, panel)


def panel_axes(towards_source: Floats) -> tuple[Floats, Floats]:
    """Axes of a panel that faces the source: u horizontal, v = n x u, which points up.

    Args:
        towards_source: unit normals n, (views, 3).

    Raises:
        TrajectoryError: a beam is vertical, so that every u is horizontal.
    """
    u = np.cross([0.0, 0.0, 1.0], towards_source)
    length = np.linalg.norm(u, axis=1)
    if (length < _STEEPEST_BEAM).any():
        raise TrajectoryError(
            f"view {int((length < _STEEPEST_BEAM).argmax())}: the beam is vertical, so no panel "
            "axis is the horizontal one; give u and v in a file of views"
        )
    u /= length[:, None]
    v = np.cross(towards_source, u)
    return u, v / np.linalg.norm(v, axis=1)[:, None]


def on_sphere(longitude: Floats, latitude: Floats, radius: float) -> Floats:
    """Points (..., 3) of longitudes and latitudes in rad."""
    cos = np.cos(latitude)
    points = [cos * np.cos(longitude), cos * np.sin(longitude), np.sin(latitude)]
    return radius * np.stack(points, axis=-1)


def stops(views: int) -> Floats:
    """Shares of the path at which views are taken; a single view stands in the middle."""
    return np.linspace(0.0, 1.0, views) if views > 1 else np.array([0.5])
