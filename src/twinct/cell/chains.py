"""Both arms of a cell as chains: what a robot's controller knows of its own geometry."""

from __future__ import annotations

import numpy as np

from twinct.cell._mujoco import mujoco_module
from twinct.cell.scene import CellModel, build_cell
from twinct.geometry import MM_PER_M, Chain, Floats, Panel, Pose
from twinct.scenario import Cell


def nominal_chains(cell: Cell, panel: Panel) -> tuple[Chain, Chain]:
    """Source and detector arm of a scenario.

    Raises:
        MissingExtraError: MuJoCo, or Menagerie where it is asked for, is not installed.
        ScenarioError: an arm that cannot be built.
    """
    return chains_of(build_cell(cell, None, Pose.identity(), panel))


def chains_of(built: CellModel) -> tuple[Chain, Chain]:
    """Source and detector arm of a room."""
    mujoco, model = mujoco_module(), built.model
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)
    # The joint that carries each body last, -1 for none.
    carriers = model.body_jntadr[model.body_weldid]
    sections = built.cell.source_arm, built.cell.detector_arm
    found = []
    for section, part, site in zip(sections, built.arm_joints, built.site_ids, strict=True):
        joints = range(part.start, part.stop)
        bodies = [np.flatnonzero(carriers == joint) for joint in joints]
        masses = np.array([model.body_mass[own].sum() for own in bodies])
        moments = np.array([model.body_mass[own] @ data.xipos[own] for own in bodies])
        base = Pose.from_euler(section.base_position_mm, section.base_rotation_deg)
        found.append(
            Chain(
                base=base.matrix,
                joints=np.array([_frame(data.xanchor[j], data.xaxis[j]) for j in joints]),
                tool=_matrix(data.site_xpos[site], data.site_xmat[site].reshape(3, 3)),
                masses=masses,
                centres=MM_PER_M * moments / np.maximum(masses, 1e-12)[:, None],
                torque_limits=built.torque_limits[part] / section.torque_scale,
            )
        )
    return found[0], found[1]


def _frame(anchor_m: Floats, axis: Floats) -> Floats:
    """A frame on a hinge, z along it; its x is square to the world's axis that z is nearest to."""
    other = np.eye(3)[(np.argmax(np.abs(axis)) + 1) % 3]
    x = other - (other @ axis) * axis
    x /= np.linalg.norm(x)
    axes = np.stack([x, np.cross(axis, x), axis], axis=1)
    return _matrix(anchor_m, np.asarray(axes, dtype=np.float64))


def _matrix(position_m: Floats, rotation: Floats) -> Floats:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, MM_PER_M * position_m
    return matrix
