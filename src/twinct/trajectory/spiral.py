"""A spiral on the sphere."""

from __future__ import annotations

from typing import Literal

import numpy as np

from twinct.core.settings import Positive, setting
from twinct.geometry import Floats, Panel, ScanGeometry
from twinct.trajectory.even import even_shares
from twinct.trajectory.family import Family
from twinct.trajectory.orbit import OrbitSettings, on_sphere, orbit_views
from twinct.trajectory.zone import LatitudeZone


class SpiralTrajectory(OrbitSettings, LatitudeZone):
    """A spiral on the sphere from the lowest latitude to the highest, in equal steps.

    Each turn rises by the same latitude, so that turns are equally far apart.
    """

    kind: Literal["spiral"]
    turns: Positive = setting(4.0, "Turns about z.")


def _views(section: SpiralTrajectory, panel: Panel) -> ScanGeometry:
    low, high = np.radians(section.latitude_range_deg)

    def position(t: Floats) -> Floats:
        turn = 2 * np.pi * section.turns * (t - 0.5)
        longitude = np.radians(section.centre_longitude_deg) + turn
        return on_sphere(longitude, low + (high - low) * t, section.sod_at(t))

    share = even_shares(position, section.views)
    return orbit_views(section, panel, position(share), share=share)


SPIRAL = Family(SpiralTrajectory, _views)
