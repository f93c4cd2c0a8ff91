"""All causes that have signatures; of two that explain as much, the earlier one is named."""

from __future__ import annotations

from twinct.diagnosis.cause import Cause
from twinct.diagnosis.motion import MOTION
from twinct.diagnosis.pixel_values import AIR, BEAM, METAL, PIXELS
from twinct.diagnosis.poses import ANGLES, DISTANCES, OFFSET, POSES, ROLL, TILT

CAUSES: tuple[Cause, ...] = (
    OFFSET,
    ROLL,
    ANGLES,
    TILT,
    DISTANCES,
    METAL,
    PIXELS,
    AIR,
    BEAM,
    MOTION,
    POSES,
)
