"""The cell and the motion of its arms, as a scenario states them."""

from twinct.robots.sections.c_arm import CArm
from twinct.robots.sections.cell import (
    DEFAULT_KIND,
    AnyCell,
    Arm,
    Cell,
    DetectorArm,
    GantryCell,
    Rail,
    Servo,
    SourceArm,
    Table,
    Turntable,
    known_arms,
)
from twinct.robots.sections.motion import InverseKinematics, Motion
from twinct.robots.sections.tool import Tool, ToolPart

__all__ = [
    "known_arms",
    "AnyCell",
    "Arm",
    "CArm",
    "Cell",
    "DEFAULT_KIND",
    "DetectorArm",
    "GantryCell",
    "InverseKinematics",
    "Motion",
    "Rail",
    "Servo",
    "SourceArm",
    "Table",
    "Tool",
    "ToolPart",
    "Turntable",
]
