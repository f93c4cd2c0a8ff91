"""A saddle: one turn with two rises and two falls."""

from __future__ import annotations

from typing import Literal

import numpy as np

from twinct.core.settings import setting
from twinct.geometry import Floats, Panel, ScanGeometry
from twinct.trajectory.even import even_shares
from twinct.trajectory.family import Family
from twinct.trajectory.orbit import OrbitSettings, on_sphere, orbit_views


class SaddleTrajectory(OrbitSettings):
    """A saddle on the sphere (after Pack, Noo, Kudo 2004): latitude = a cos(2 longitude).

    The path is closed: every plane through the middle of the object intersects it. The first view
    is at the highest latitude.
    """

    kind: Literal["saddle"]
    latitude_amplitude_deg: float = setting(30.0, "Highest latitude, a.", ge=0, lt=90)


def _views(section: SaddleTrajectory, panel: Panel) -> ScanGeometry:
    def position(t: Floats) -> Floats:
        longitude = np.radians(section.centre_longitude_deg) + 2 * np.pi * t
        latitude = np.radians(section.latitude_amplitude_deg) * np.cos(4 * np.pi * t)
        return on_sphere(longitude, latitude, section.sod_at(t))

    share = even_shares(position, section.views, closed=True)
    return orbit_views(section, panel, position(share), share=share)


SADDLE = Family(SaddleTrajectory, _views)
