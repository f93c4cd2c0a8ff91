"""Kinematic chains of both arms of a cell: the geometry that a robot's controller assumes."""

from __future__ import annotations

import numpy as np

from twinct.geometry import MM_PER_M, Chain, Floats, Panel, Pose
from twinct.robots.cell._mujoco import mujoco_module
from twinct.robots.cell.scene import CellModel, build_cell
from twinct.robots.sections import Cell


def nominal_chains(cell: Cell, panel: Panel) -> tuple[Chain, Chain]:
    """Return the chains of source and detector arm of a scenario.

    Raises:
        MissingExtraError: MuJoCo, or a requested Menagerie, is not installed.
        ScenarioError: an arm cannot be built.
    """
    return chains_of(build_cell(cell, None, Pose.identity(), panel))


def joint_names_of(cell: Cell, panel: Panel) -> tuple[str, ...]:
    """Return the names of all joints of a scenario's arms, source first; see ``nominal_chains``."""
    return build_cell(cell, None, Pose.identity(), panel).joint_names


def chains_of(built: CellModel) -> tuple[Chain, Chain]:
    """Return the chains of source and detector arm of a compiled cell."""
    mujoco, model = mujoco_module(), built.model
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)
    # The last joint that moves each body, -1 for none.
    carriers = model.body_jntadr[model.body_weldid]
    sections = built.cell.source_arm, built.cell.detector_arm
    chains = []
    for section, part, site in zip(sections, built.arm_joints, built.site_ids, strict=True):
        joints = range(part.start, part.stop)
        bodies = [np.flatnonzero(carriers == joint) for joint in joints]
        masses = np.array([model.body_mass[own].sum() for own in bodies])
        moments = np.array([model.body_mass[own] @ data.xipos[own] for own in bodies])
        slides = mujoco.mjtJoint.mjJNT_SLIDE
        base = Pose.from_euler(section.base_position_mm, section.base_rotation_deg)
        chains.append(
            Chain(
                base=base.matrix,
                joints=np.array([_frame(data.xanchor[j], data.xaxis[j]) for j in joints]),
                tool=_matrix(data.site_xpos[site], data.site_xmat[site].reshape(3, 3)),
                masses=masses,
                centres=MM_PER_M * moments / np.maximum(masses, 1e-12)[:, None],
                torque_limits=built.torque_limits[part] / section.torque_scale,
                rails=tuple(k for k, j in enumerate(joints) if model.jnt_type[j] == slides),
            )
        )
    return chains[0], chains[1]


def _frame(anchor_m: Floats, axis: Floats) -> Floats:
    """Return a frame on a joint, z along its axis, x the projection of the next world axis."""
    other = np.eye(3)[(np.argmax(np.abs(axis)) + 1) % 3]
    x = other - (other @ axis) * axis
    x /= np.linalg.norm(x)
    axes = np.stack([x, np.cross(axis, x), axis], axis=1)
    return _matrix(anchor_m, np.asarray(axes, dtype=np.float64))


def _matrix(position_m: Floats, rotation: Floats) -> Floats:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, MM_PER_M * position_m
    return matrix
