"""Paths rotated about a horizontal axis."""

from __future__ import annotations

import numpy as np

from twinct.core.settings import Finite, Section, setting
from twinct.geometry import Floats


class Tilted(Section):
    """Keys of a path that may be tilted."""

    tilt_deg: Finite = setting(
        0.0, "Tilt of the path about a horizontal axis through the isocentre."
    )
    tilt_axis_deg: Finite = setting(0.0, "Longitude of that axis; 0 is the x axis.")


def tilted(points: Floats, section: Tilted) -> Floats:
    """Rotate points (n, 3) about the isocentre by the tilt, right-handed about its axis."""
    axis, tilt = np.radians([section.tilt_axis_deg, section.tilt_deg])
    cos, sin = np.cos(tilt), np.sin(tilt)
    about_x = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]])
    if axis == 0:
        return points @ about_x.T
    cos, sin = np.cos(axis), np.sin(axis)
    world_from_axis = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    return points @ (world_from_axis @ about_x @ world_from_axis.T).T
