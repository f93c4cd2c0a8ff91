"""The paper's path."""

from __future__ import annotations

from typing import Literal

import numpy as np

from twinct.geometry import Floats, Panel, ScanGeometry
from twinct.settings import Positive, setting
from twinct.trajectory.family import Family
from twinct.trajectory.orbit import OrbitSettings, on_sphere, orbit_views, stops

_PATH_SAMPLES = 200_001
"""Points on which arc length is summed; the paper's path of 1.2 m is then exact to 1e-7 mm."""


class SinusoidTrajectory(OrbitSettings):
    """The paper's path: a sine of latitude over an arc of longitude, on a sphere."""

    kind: Literal["sinusoid"]
    longitude_range_deg: float = setting(
        210.0, "Arc of longitude.", gt=0, le=360, source="the paper: 180 degrees and the fan"
    )
    latitude_amplitude_deg: float = setting(
        30.0, "Amplitude of the sine of latitude.", ge=0, lt=90, source="the paper"
    )
    periods: Positive = setting(
        1.0, "Sine periods over the range.", source="the paper, as docs/paper.md reads it"
    )


def _views(section: SinusoidTrajectory, panel: Panel) -> ScanGeometry:
    """Longitude over its range, latitude a sine of it (Freiling et al.); both ends included."""
    share: Floats = np.linspace(0.0, 1.0, _PATH_SAMPLES)

    def position(t: Floats) -> Floats:
        longitude = section.centre_longitude_deg + section.longitude_range_deg * (t - 0.5)
        wave = np.sin(2 * np.pi * section.periods * t)
        latitude = np.radians(section.latitude_amplitude_deg) * wave
        return on_sphere(np.radians(longitude), latitude, section.sod_mm)

    steps = np.linalg.norm(np.diff(position(share), axis=0), axis=1)
    length = np.concatenate([[0.0], np.cumsum(steps)])
    at: Floats = np.interp(stops(section.views) * length[-1], length, share)
    return orbit_views(section, panel, position(at))


SINUSOID = Family(SinusoidTrajectory, _views)
