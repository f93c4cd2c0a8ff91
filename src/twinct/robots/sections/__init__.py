"""The cell and the motion of its arms, as a scenario states them."""

from twinct.robots.sections.cell import (
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
    known_arms,
)
from twinct.robots.sections.motion import InverseKinematics, Motion

__all__ = [
    "known_arms",
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
