"""Derivatives of the poses of an arm's tool by the deviations of its parts."""

from __future__ import annotations

import numpy as np

from twinct.geometry import Floats, exp_matrices
from twinct.uncertainty.error_terms import Place, ToolMotion


def derivatives(motion: ToolMotion) -> dict[Place, Floats]:
    """Return the derivatives of a tool's error by the deviations of each place.

    An error is the displacement and rotation of the tool along and about the world's axes.

    Returns:
        (views, frames, 6, 6), the last axis for the twist of a frame; of ``joints``
        (views, joints, 6). A gantry has ``pose`` alone.
    """
    tools, chain = motion.poses, motion.chain
    own = carried(tools, tools)[:, None]
    if chain is None:
        return {"pose": own}
    frames = chain.frames(motion.joints)[:, :-1]
    # A link's errors refer to the axes of its frame before the motion of the joint.
    still = frames @ np.linalg.inv(exp_matrices(chain.moves(motion.joints)))
    links = carried(still, tools[:, None])
    base = carried(np.broadcast_to(chain.base, tools.shape), tools)[:, None]
    joints = np.einsum("vjik,jk->vji", links, chain.moves(np.ones(len(chain))))
    return {"base": base, "links": links, "joints": joints, "tool": own, "pose": own}


def carried(frames: Floats, tools: Floats) -> Floats:
    """Return matrices from twists of frames, in their axes, to errors of tools, (..., 6, 6)."""
    rotation = frames[..., :3, :3]
    arms = tools[..., :3, 3] - frames[..., :3, 3]
    result = np.zeros((*rotation.shape[:-2], 6, 6))
    result[..., :3, :3] = result[..., 3:, 3:] = rotation
    # The columns are w x r for each axis of the frame.
    turned = np.cross(np.swapaxes(rotation, -1, -2), arms[..., None, :])
    result[..., :3, 3:] = np.swapaxes(turned, -1, -2)
    return result
