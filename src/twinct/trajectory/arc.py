"""Part of a circle."""

from __future__ import annotations

from typing import Literal

import numpy as np

from twinct.core.settings import setting
from twinct.geometry import Panel, ScanGeometry
from twinct.trajectory.family import Family
from twinct.trajectory.orbit import OrbitSettings, on_sphere, orbit_views, stops
from twinct.trajectory.tilt import Tilted, tilted


class ArcTrajectory(OrbitSettings, Tilted):
    """Part of a circle of constant latitude, both ends included; it may be tilted as a whole."""

    kind: Literal["arc"]
    longitude_range_deg: float = setting(
        210.0, "Arc of longitude.", gt=0, le=360, source="180 degrees plus the paper's fan angle"
    )
    latitude_deg: float = setting(0.0, "Latitude of the source; 90 is +z.", gt=-90, lt=90)


def _views(section: ArcTrajectory, panel: Panel) -> ScanGeometry:
    share = stops(section.views)
    offset = section.longitude_range_deg * (share - 0.5)
    longitude = np.radians(section.centre_longitude_deg + offset)
    latitude = np.full_like(longitude, np.radians(section.latitude_deg))
    sources = on_sphere(longitude, latitude, section.sod_at(share))
    return orbit_views(section, panel, tilted(sources, section))


ARC = Family(ArcTrajectory, _views)
