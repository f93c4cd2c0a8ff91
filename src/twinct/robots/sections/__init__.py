"""The cell and the motion of its arms, as a scenario states them."""

from twinct.robots.sections.cell import (
    ARMS,
    DEFAULT_KIND,
    AnyCell,
    Arm,
    Cell,
    DetectorArm,
    GantryCell,
    Rail,
    SourceArm,
    Table,
    Turntable,
)
from twinct.robots.sections.motion import InverseKinematics, Motion

__all__ = [
    "ARMS",
    "AnyCell",
    "Arm",
    "Cell",
    "DEFAULT_KIND",
    "DetectorArm",
    "GantryCell",
    "InverseKinematics",
    "Motion",
    "Rail",
    "SourceArm",
    "Table",
    "Turntable",
]
