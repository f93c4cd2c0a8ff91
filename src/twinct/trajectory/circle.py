"""A full circle."""

from __future__ import annotations

from typing import Literal

import numpy as np

from twinct.geometry import Panel, ScanGeometry
from twinct.trajectory.family import Family
from twinct.trajectory.orbit import OrbitSettings, on_sphere, orbit_views
from twinct.trajectory.tilt import Tilted, tilted


class CircleTrajectory(OrbitSettings, Tilted):
    """A full circle; the first and last view are one step apart."""

    kind: Literal["circle"]


def _views(section: CircleTrajectory, panel: Panel) -> ScanGeometry:
    share = np.arange(section.views) / section.views
    angles = np.radians(section.centre_longitude_deg) + 2 * np.pi * share
    flat = on_sphere(angles, np.zeros_like(angles), section.sod_at(share))
    return orbit_views(section, panel, tilted(flat, section), share=share)


CIRCLE = Family(CircleTrajectory, _views)
