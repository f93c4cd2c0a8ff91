"""Part of a circle, and an arc across its middle."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from twinct.core.settings import setting
from twinct.geometry import Panel, ScanGeometry
from twinct.trajectory.family import Family
from twinct.trajectory.orbit import OrbitSettings, on_sphere, orbit_views, stops


class CircleArcTrajectory(OrbitSettings):
    """A circle about z, or a part of it, then an arc along the meridian through its middle.

    The arc measures the planes that a circle misses (Wang, Ning 1999).
    """

    kind: Literal["circle_arc"]
    views: int = Field(ge=2, le=100_000, description="Number of projections.")
    longitude_range_deg: float = setting(
        360.0,
        "Arc of longitude of the circle; 360: its last view is one step before the first.",
        gt=0,
        le=360,
    )
    arc_latitude_deg: float = setting(
        30.0, "The arc runs from minus this latitude to plus this latitude.", gt=0, lt=90
    )
    arc_share: float = setting(0.25, "Share of the views on the arc.", gt=0, lt=1)


def _views(section: CircleArcTrajectory, panel: Panel) -> ScanGeometry:
    on_arc = min(max(round(section.views * section.arc_share), 1), section.views - 1)
    round_ = section.views - on_arc
    closed = section.longitude_range_deg == 360
    along = np.arange(round_) / round_ if closed else stops(round_)
    middle = np.full(on_arc, np.radians(section.centre_longitude_deg))
    offset = np.radians(section.longitude_range_deg) * (along - 0.5)
    longitude = np.concatenate([middle[:1] + offset, middle])
    height = np.radians(section.arc_latitude_deg) * (2 * stops(on_arc) - 1)
    latitude = np.concatenate([np.zeros(round_), height])
    share = stops(section.views)
    return orbit_views(section, panel, on_sphere(longitude, latitude, section.sod_at(share)))


CIRCLE_ARC = Family(CircleArcTrajectory, _views)
