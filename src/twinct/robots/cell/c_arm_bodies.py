"""The bodies of a C-arm: the C with its struts, the sleeve that holds it, and the column."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from twinct.geometry import Pose
from twinct.robots.c_arm import CARRIERS, CArmKinematics
from twinct.robots.cell.solids import add_box, add_rod
from twinct.robots.sections import CArm

if TYPE_CHECKING:
    import mujoco

SEGMENTS = 24
"""Boxes that make up the half circle of a C; they reach 0.2 % of its radius beyond it."""

STRUT_MM, COLUMN_MM = 50.0, 90.0
"""Radii of the struts between the C and its tools, and of the column and its arm."""

SLEEVE_MM = 240.0
"""Length of the sleeve along the C; it is wider than the C by the radius of a strut."""

COLUMN = "c_arm_column"
"""Name of the part of the column that stands still."""


def add_c_arm(
    spec: mujoco.MjSpec,
    section: CArm,
    views: tuple[Pose, Pose],
    behind_mm: tuple[float, float],
    floor_z_mm: float,
) -> None:
    """Add a C-arm as it stands at one view.

    Args:
        spec: the model.
        section: the machine.
        views: poses of source and panel.
        behind_mm: lengths of source and panel behind focal spot and active area, mm.
        floor_z_mm: height of the floor.
    """
    kinematics = CArmKinematics(section)
    places = kinematics.carriers(kinematics.nearest(*views))
    c, sleeve, lift = (_placed(spec, name, places[name]) for name in CARRIERS)
    _add_c(c, section, behind_mm)
    thick, wide = section.profile_mm
    outer = section.radius_mm + thick
    back = outer + section.column_mm
    size = (thick + 2 * STRUT_MM, wide + 2 * STRUT_MM, SLEEVE_MM)
    add_box(sleeve, CARRIERS[1], (STRUT_MM - outer, 0, 0), size, "housing")
    add_rod(lift, CARRIERS[2], (-outer - STRUT_MM, 0, 0), (-back, 0, 0), COLUMN_MM, "tube")
    _add_column(spec, lift, section, back, floor_z_mm)


def _add_c(body: Any, section: CArm, behind_mm: tuple[float, float]) -> None:
    thick, wide = section.profile_mm
    middle = section.radius_mm + thick / 2
    each = np.pi / SEGMENTS
    length = 2 * (section.radius_mm + thick) * np.tan(each / 2)
    for index, angle in enumerate(np.pi / 2 + each * (np.arange(SEGMENTS) + 0.5)):
        centre = (middle * np.cos(angle), 0, middle * np.sin(angle))
        # A box with its x along the radius, turned about y.
        quat = (np.cos(angle / 2), 0, -np.sin(angle / 2), 0)
        add_box(body, f"c_arm_{index}", centre, (thick, wide, length), "tube", quat=quat)
    ends = -section.sod_mm - behind_mm[0], section.sdd_mm - section.sod_mm + behind_mm[1]
    for side, end, sign in (("source", ends[0], -1), ("detector", ends[1], 1)):
        if abs(end) < section.radius_mm:
            foot = (0, 0, sign * section.radius_mm)
            add_rod(body, f"c_arm_{side}_strut", (0, 0, end), foot, STRUT_MM, "tube")


def _add_column(
    spec: mujoco.MjSpec, lift: Any, section: CArm, back: float, floor_z_mm: float
) -> None:
    """Add the column behind the C, from its end to the lifting part."""
    behind = np.array(section.isocentre_mm) - back * section.directions[0]
    low, high = (behind[2] + of for of in section.lift_mm)
    end = floor_z_mm if section.column_to_z_mm is None else section.column_to_z_mm
    down = end < low
    near = (low if down else high) + (-COLUMN_MM if down else COLUMN_MM)
    travel = high - low
    if travel > 0:  # the inner tube, hidden in the column at one end of the lift
        # The lifting part has the C's axes at both angles zero.
        zero = CArmKinematics(section).carriers(np.zeros(5))[CARRIERS[2]]
        way = (-travel if down else travel) + (-COLUMN_MM if down else COLUMN_MM)
        start, stop = (zero.inverse().apply(p) for p in (behind, behind + (0, 0, way)))
        add_rod(lift, "c_arm_inner", start, stop, 0.8 * COLUMN_MM, "steel")
    if abs(near - end) < 1:
        return
    column = spec.worldbody.add_body(name=COLUMN)
    x, y = behind[:2]
    add_rod(column, COLUMN, (x, y, end), (x, y, near), COLUMN_MM, "pedestal")


def _placed(spec: mujoco.MjSpec, name: str, pose: Pose) -> Any:
    position, quat = pose.to_metres()
    return spec.worldbody.add_body(name=name, pos=position, quat=np.roll(quat, 1))
