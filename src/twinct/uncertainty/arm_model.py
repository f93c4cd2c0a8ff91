"""Arm with errors: the poses of its tool, and their derivatives.

The frames of base, joints and tool are displaced, and each joint deviates behind its encoder. Drawn
errors, propagation and calibrated arms all use this model.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from twinct.geometry import Chain, Floats, Misfit, exp_matrices
from twinct.uncertainty.error_terms import Place, Shift, ToolMotion


def shifted_tools(chain: Chain, joints: Floats, shifts: Iterable[Shift]) -> Floats:
    """Return ``world_from_tool`` of an arm with deviations, which add up in their order.

    Args:
        chain: nominal arm.
        joints: encoder readings, (views, joints), rad.
        shifts: deviations, with any number of axes before that of the views.

    Returns:
        (..., views, 4, 4), mm.
    """
    base, links, tool = np.zeros(6), np.zeros((len(chain), 6)), np.zeros(6)
    behind: Floats | None = None
    for shift in shifts:
        base = base if shift.base is None else base + shift.base
        links = links if shift.links is None else links + shift.links
        tool = tool if shift.tool is None else tool + shift.tool
        for turn in shift.joints:
            behind = turn if behind is None else behind + turn
    here = joints if behind is None else joints + behind
    return chain.tools(here, Misfit(base=base, links=links, tool=tool))


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
