"""A helix."""

from __future__ import annotations

from typing import Literal

import numpy as np

from twinct.core.settings import Finite, Positive, setting
from twinct.geometry import Panel, ScanGeometry
from twinct.trajectory.family import Family
from twinct.trajectory.orbit import OrbitSettings, on_sphere, orbit_views, stops
from twinct.trajectory.tilt import Tilted, tilted


class HelixTrajectory(OrbitSettings, Tilted):
    """A helix about z: source and panel rise together; it may be tilted as a whole."""

    kind: Literal["helix"]
    turns: Positive = setting(2.0, "Turns about z.")
    pitch_mm: Finite = setting(50.0, "Rise per turn.")


def _views(section: HelixTrajectory, panel: Panel) -> ScanGeometry:
    share = stops(section.views)
    turn = section.turns * (share - 0.5)
    angles = np.radians(section.centre_longitude_deg) + 2 * np.pi * turn
    centres = np.zeros((section.views, 3))
    centres[:, 2] = section.pitch_mm * turn
    sources = on_sphere(angles, np.zeros_like(angles), section.sod_at(share)) + centres
    return orbit_views(section, panel, tilted(sources, section), tilted(centres, section))


HELIX = Family(HelixTrajectory, _views)
