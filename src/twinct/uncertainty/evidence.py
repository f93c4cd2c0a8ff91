"""Records of the arms in a scan: the only input of a model of the believed poses."""

from __future__ import annotations

from dataclasses import dataclass

from twinct.geometry import Floats
from twinct.geometry.wire import PosePairs
from twinct.scenario import AnyCell


@dataclass(frozen=True, eq=False)
class Evidence:
    """Records of the arms at each exposure.

    Attributes:
        cell: section of the cell, as the controllers know it.
        joint_names: source arm first; none with a gantry.
        encoders: encoder readings, (views, joints), rad.
        nominal: poses that the controllers compute from them with their nominal model.
    """

    cell: AnyCell
    joint_names: tuple[str, ...]
    encoders: Floats
    nominal: PosePairs
