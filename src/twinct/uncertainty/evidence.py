"""What a scan leaves of the arms: all that a model of the believed poses may look at."""

from __future__ import annotations

from dataclasses import dataclass

from twinct.geometry import Floats
from twinct.scenario import AnyCell
from twinct.views import PosePairs


@dataclass(frozen=True, eq=False)
class Evidence:
    """The arms at each exposure.

    Attributes:
        cell: the room, as the controllers know it.
        joint_names: source arm first; none with a gantry.
        encoders: what the encoders read, (views, joints), rad.
        told: what the controllers make of that by their nominal model.
    """

    cell: AnyCell
    joint_names: tuple[str, ...]
    encoders: Floats
    told: PosePairs
