"""The paper's path."""

from __future__ import annotations

from typing import Literal

import numpy as np

from twinct.core.settings import Finite, Positive, setting
from twinct.geometry import Floats, Panel, ScanGeometry
from twinct.trajectory.even import even_shares
from twinct.trajectory.family import Family
from twinct.trajectory.orbit import OrbitSettings, on_sphere, orbit_views


class SinusoidTrajectory(OrbitSettings):
    """The paper's path: a sine of latitude over an arc of longitude, on a sphere.

    An arc of more than 360 degrees makes several turns.
    """

    kind: Literal["sinusoid"]
    longitude_range_deg: float = setting(
        210.0,
        "Arc of longitude; 360 per turn.",
        gt=0,
        le=36_000,
        source="the paper: 180 degrees plus the fan angle",
    )
    latitude_amplitude_deg: float = setting(
        30.0, "Amplitude of the sine of latitude.", ge=0, lt=90, source="the paper"
    )
    periods: Positive = setting(
        1.0, "Sine periods over the range.", source="the paper, as docs/paper.md reads it"
    )
    phase_deg: Finite = setting(0.0, "Phase of the sine at the start.")


def _views(section: SinusoidTrajectory, panel: Panel) -> ScanGeometry:
    """Return the views: latitude is a sine of longitude (Freiling et al.), both ends included."""
    phase = np.radians(section.phase_deg)

    def position(t: Floats) -> Floats:
        longitude = section.centre_longitude_deg + section.longitude_range_deg * (t - 0.5)
        wave = np.sin(2 * np.pi * section.periods * t + phase)
        latitude = np.radians(section.latitude_amplitude_deg) * wave
        return on_sphere(np.radians(longitude), latitude, section.sod_at(t))

    share = even_shares(position, section.views)
    return orbit_views(section, panel, position(share), share=share)


SINUSOID = Family(SinusoidTrajectory, _views)
