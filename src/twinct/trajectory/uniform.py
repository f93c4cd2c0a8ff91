"""Views spread evenly over a zone of the sphere."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from twinct.core.settings import setting
from twinct.geometry import Panel, ScanGeometry
from twinct.trajectory.family import Family
from twinct.trajectory.orbit import OrbitSettings, on_sphere, orbit_views
from twinct.trajectory.zone import LatitudeZone

GOLDEN = (math.sqrt(5) - 1) / 2
"""Step of a Fibonacci lattice, as a share of the range of longitude."""


class UniformTrajectory(OrbitSettings, LatitudeZone):
    """Views of equal density over a zone of the sphere: a Fibonacci lattice (Gonzalez 2010).

    From view to view, the latitude rises and the longitude jumps far: ``motion.order: shortest``
    makes a short tour.
    """

    kind: Literal["uniform"]
    longitude_range_deg: float = setting(360.0, "Arc of longitude.", gt=0, le=360)


def _views(section: UniformTrajectory, panel: Panel) -> ScanGeometry:
    number = np.arange(section.views)
    share = (number + 0.5) / section.views
    offset = section.longitude_range_deg * ((number * GOLDEN) % 1.0 - 0.5)
    longitude = np.radians(section.centre_longitude_deg + offset)
    sources = on_sphere(longitude, section.heights(share), section.sod_at(share))
    return orbit_views(section, panel, sources, share=share)


UNIFORM = Family(UniformTrajectory, _views)
