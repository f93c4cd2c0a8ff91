"""A full circle."""

from __future__ import annotations

from typing import Literal

import numpy as np

from twinct.geometry import Panel, ScanGeometry
from twinct.settings import Finite, setting
from twinct.trajectory.family import Family
from twinct.trajectory.orbit import OrbitSettings, on_sphere, orbit_views


class CircleTrajectory(OrbitSettings):
    """A full circle; the first and last view are one step apart."""

    kind: Literal["circle"]
    tilt_deg: Finite = setting(0.0, "Tilt of the circle about the x axis.")


def _views(section: CircleTrajectory, panel: Panel) -> ScanGeometry:
    share = np.arange(section.views) / section.views
    angles = np.radians(section.centre_longitude_deg) + 2 * np.pi * share
    flat = on_sphere(angles, np.zeros_like(angles), section.sod_mm)
    tilt = np.radians(section.tilt_deg)
    cos, sin = np.cos(tilt), np.sin(tilt)
    about_x = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]])
    return orbit_views(section, panel, flat @ about_x.T)


CIRCLE = Family(CircleTrajectory, _views)
