"""Rails and turntables under arms: what moves, what stands, and the joint in the model."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

from twinct.geometry import Floats, Pose
from twinct.robots.cell._mujoco import mujoco_module
from twinct.robots.cell.arms import ArmModel
from twinct.robots.cell.solids import MM, VISUAL_GROUP
from twinct.robots.sections import Arm, Rail, Turntable

if TYPE_CHECKING:
    import mujoco

JOINT, TURNTABLE_JOINT = "rail", "turntable"
"""Names of the joints, before the arm's prefix."""

TRACK_MM = (240.0, 80.0)
"""Width and depth of a track."""

CARRIAGE_MM = (320.0, 420.0, 40.0)
"""Length along the rail, width and depth of a carriage."""

OVERHANG_MM = 220.0
"""Length of the track beyond the limits."""

PILLAR_RADIUS_MM = 100.0

PLATE_MM = (40.0, 220.0)
"""Depth of a turntable's plate, and its edge beyond the middle of the arm's base."""

FOOT_MM = (80.0, 60.0)
"""Depth of the foot below the plate, and the part of the plate's radius beyond it."""


def on_rail(loaded: ArmModel, rail: Rail) -> ArmModel:
    """Return the arm with the rail as its first joint; its unit is m instead of rad."""
    low, high = rail.range_mm
    home = loaded.home
    if home is not None:
        home = np.concatenate([[float(np.clip(0.0, low, high)) * MM], home])
    return replace(
        loaded,
        joint_names=(JOINT, *loaded.joint_names),
        torque_limits=np.concatenate([[rail.force_n], loaded.torque_limits]),
        speed_limits=np.concatenate([[rail.speed_mm_s * MM], loaded.speed_limits]),
        home=home,
    )


def direction(rail: Rail) -> Floats:
    """Return the unit vector along the rail."""
    axis = np.array(rail.axis)
    return axis / np.linalg.norm(axis)


def add_rail(spec: mujoco.MjSpec, side: str, arm: Arm, rail: Rail, depth_mm: float) -> Any:
    """Add track and carriage, and return the carriage, whose frame is the world's at the base.

    Args:
        spec: model of the cell.
        side: prefix of the arm.
        arm: section of the arm.
        rail: its rail.
        depth_mm: distance from the arm's base to the lower face of the track.
    """
    mujoco = mujoco_module()
    axis, base = direction(rail), np.array(arm.base_position_mm)
    carriage = spec.worldbody.add_body(name=f"{side}_carriage", pos=base * MM)
    carriage.add_joint(
        name=f"{side}_{JOINT}",
        type=mujoco.mjtJoint.mjJNT_SLIDE,
        axis=axis,
        range=np.array(rail.range_mm) * MM,
        limited=mujoco.mjtLimited.mjLIMITED_TRUE,
    )
    turned, outward = _turned(axis, arm)
    quat = np.roll(turned.as_quat(), 1)
    box, deep = mujoco.mjtGeom.mjGEOM_BOX, TRACK_MM[1]
    look = {"type": box, "group": VISUAL_GROUP, "quat": quat}
    pillar = depth_mm - deep - CARRIAGE_MM[2]
    carriage.add_geom(
        name=f"{side}_carriage",
        size=np.array(CARRIAGE_MM) / 2 * MM,
        pos=-outward * (pillar + CARRIAGE_MM[2] / 2) * MM,
        mass=rail.carriage_mass_kg * (0.5 if pillar > 0 else 1.0),
        material="pedestal",
        **look,
    )
    if pillar > 0:
        carriage.add_geom(
            name=f"{side}_pillar",
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            fromto=np.concatenate([np.zeros(3), -outward * pillar * MM]),
            size=[PILLAR_RADIUS_MM * MM, 0, 0],
            mass=rail.carriage_mass_kg / 2,
            material="pedestal",
            group=VISUAL_GROUP,
        )
    low, high = rail.range_mm
    middle = base + axis * (low + high) / 2 - outward * (depth_mm - deep / 2)
    track = spec.worldbody.add_body(name=f"{side}_track")
    length = high - low + 2 * OVERHANG_MM
    size = np.array([length, TRACK_MM[0], deep]) / 2 * MM
    track.add_geom(name=f"{side}_track", size=size, pos=middle * MM, material="steel", **look)
    spec.add_exclude(bodyname1=f"{side}_carriage", bodyname2=f"{side}_track")
    return carriage


def _turned(axis: Floats, arm: Arm) -> tuple[scipy.spatial.transform.Rotation, Floats]:
    """Return the rotation of track and carriage, x along the rail, and their outward direction."""
    z = Pose.from_euler((0, 0, 0), arm.base_rotation_deg).rotation[:, 2]
    if abs(float(z @ axis)) > 0.99:  # the arm points along its rail
        z = np.eye(3)[int(np.abs(axis).argmin())]
    z = z - (z @ axis) * axis
    z /= np.linalg.norm(z)
    axes = np.stack([axis, np.cross(z, axis), z], axis=1)
    return scipy.spatial.transform.Rotation.from_matrix(axes), z


def on_turntable(loaded: ArmModel, turntable: Turntable) -> ArmModel:
    """Return the arm with the turntable as its first joint."""
    low, high = turntable.range_deg
    home = loaded.home
    if home is not None:
        home = np.concatenate([[np.radians(np.clip(0.0, low, high))], home])
    return replace(
        loaded,
        joint_names=(TURNTABLE_JOINT, *loaded.joint_names),
        torque_limits=np.concatenate([[turntable.torque_nm], loaded.torque_limits]),
        speed_limits=np.concatenate([[np.radians(turntable.speed_deg_s)], loaded.speed_limits]),
        home=home,
    )


def axis_of(turntable: Turntable) -> Floats:
    """Return the unit vector along the axis."""
    axis = np.array(turntable.axis)
    return axis / np.linalg.norm(axis)


def add_turntable(
    spec: mujoco.MjSpec, side: str, arm: Arm, turntable: Turntable, depth_mm: float
) -> Any:
    """Add foot and plate, and return the plate; at 0 its frame is the world's at ``centre_mm``.

    Args:
        spec: model of the cell.
        side: prefix of the arm.
        arm: section of the arm.
        turntable: its turntable.
        depth_mm: distance from the arm's base to the lower face of the foot, along the axis.
    """
    mujoco = mujoco_module()
    axis, off = axis_of(turntable), -np.array(turntable.centre_mm)
    centre = np.array(arm.base_position_mm) - off
    upwards = Pose.from_euler((0, 0, 0), arm.base_rotation_deg).rotation[:, 2]
    outward = axis if upwards @ axis >= 0 else -axis
    plate = spec.worldbody.add_body(name=f"{side}_turntable", pos=centre * MM)
    plate.add_joint(
        name=f"{side}_{TURNTABLE_JOINT}",
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=axis,
        range=np.radians(turntable.range_deg),
        limited=mujoco.mjtLimited.mjLIMITED_TRUE,
    )
    level = (off @ axis) * axis
    radius = float(np.linalg.norm(off - level)) + PLATE_MM[1]
    pillar = depth_mm - PLATE_MM[0] - FOOT_MM[0]
    look = {"type": mujoco.mjtGeom.mjGEOM_CYLINDER, "group": VISUAL_GROUP}
    top = level - outward * pillar
    plate.add_geom(
        name=f"{side}_turntable",
        fromto=np.concatenate([top, top - outward * PLATE_MM[0]]) * MM,
        size=[radius * MM, 0, 0],
        mass=turntable.mass_kg * (0.5 if pillar > 0 else 1.0),
        material="pedestal",
        **look,
    )
    if pillar > 0:
        plate.add_geom(
            name=f"{side}_pillar",
            fromto=np.concatenate([off, off - outward * pillar]) * MM,
            size=[PILLAR_RADIUS_MM * MM, 0, 0],
            mass=turntable.mass_kg / 2,
            material="pedestal",
            **look,
        )
    foot = spec.worldbody.add_body(name=f"{side}_turntable_foot", pos=centre * MM)
    low = top - outward * PLATE_MM[0]
    foot.add_geom(
        name=f"{side}_turntable_foot",
        fromto=np.concatenate([low, low - outward * FOOT_MM[0]]) * MM,
        size=[(radius - FOOT_MM[1]) * MM, 0, 0],
        material="steel",
        **look,
    )
    spec.add_exclude(bodyname1=f"{side}_turntable", bodyname2=f"{side}_turntable_foot")
    return plate


def turned_back(poses: Floats, turntable: Turntable, base_m: Floats, angles: Floats) -> Floats:
    """Return poses as the arm sees them whose turntable stands at some angles, (p, 4, 4), m.

    Args:
        poses: ``world_from_tool``, m, (p, 4, 4).
        turntable: the turntable.
        base_m: ``base_position_mm``, m.
        angles: rad, (p,); NaN gives NaN.
    """
    centre = base_m + np.array(turntable.centre_mm) * MM
    turns = np.tile(np.eye(4), (len(angles), 1, 1))
    known = np.where(np.isnan(angles), 0.0, angles)
    vectors = -known[:, None] * axis_of(turntable)
    turns[:, :3, :3] = scipy.spatial.transform.Rotation.from_rotvec(vectors).as_matrix()
    turns[:, :3, 3] = centre - turns[:, :3, :3] @ centre
    return np.where(np.isnan(angles)[:, None, None], np.nan, turns @ poses)
