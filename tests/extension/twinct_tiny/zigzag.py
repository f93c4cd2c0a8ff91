"""An arc whose views lie above and below it in turn."""

from typing import Literal

import numpy as np
from pydantic import Field

from twinct.geometry import Panel, ScanGeometry
from twinct.trajectory import Family, OrbitSettings, on_sphere, orbit_views, stops


class Zigzag(OrbitSettings):
    """An arc whose views lie above and below it in turn."""

    kind: Literal["zigzag"]
    range_deg: float = Field(default=20.0, gt=0, le=360, description="Arc of longitude.")
    latitude_deg: float = Field(default=2.0, ge=0, lt=90, description="Above and below.")


def _views(section: Zigzag, panel: Panel) -> ScanGeometry:
    longitude = section.centre_longitude_deg + section.range_deg * (stops(section.views) - 0.5)
    latitude = section.latitude_deg * (-1.0) ** np.arange(section.views)
    path = on_sphere(np.radians(longitude), np.radians(latitude), section.sod_mm)
    return orbit_views(section, panel, path)


ZIGZAG = Family(Zigzag, _views)
