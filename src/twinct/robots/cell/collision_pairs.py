"""Pairs of bodies of the cell that can collide, and how far a joint can move each body."""

from __future__ import annotations

from collections.abc import Collection
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from twinct.geometry import Floats
from twinct.robots.cell._mujoco import mujoco_module

if TYPE_CHECKING:
    import mujoco

FAR_M = 0.3
"""Gap beyond which a body that stands still affects no plan."""


def exclude_adjacent(spec: mujoco.MjSpec, tools: Collection[str] = ()) -> None:
    """Let bodies that are joined touch each other; MuJoCo itself filters only moving parents.

    Args:
        spec: the cell.
        tools: bodies whose shapes are a user's, and may reach back to the link before the last.
    """
    listed = {frozenset((e.bodyname1, e.bodyname2)) for e in spec.excludes}
    bodies = [body for body in spec.bodies if body.name != "world"]
    for link in (body for body in bodies if body.joints):
        carrier = _link_of(link.parent)
        carriers = [link.parent.name]
        if carrier.joints:  # a moving link: all its bodies are adjacent
            carriers = sorted({b.name for b in bodies if _link_of(b).name == carrier.name})
        pieces = [body.name for body in bodies if _link_of(body).name == link.name]
        for pair in product(pieces, carriers):
            if frozenset(pair) not in listed and pair[0] not in tools:
                spec.add_exclude(bodyname1=pair[0], bodyname2=pair[1])


def _link_of(body: Any) -> Any:
    """Return the body with the joint; bodies without a joint are part of their parent's link."""
    while not body.joints and body.parent is not None and body.parent.name != "world":
        body = body.parent
    return body


def non_adjacent_pairs(model: mujoco.MjModel) -> np.ndarray:
    """Return the pairs of solid geoms of bodies that can move against each other, not excluded."""
    excluded = np.zeros((model.nbody, model.nbody), bool)
    excluded[model.exclude_signature >> 16, model.exclude_signature & 0xFFFF] = True
    excluded |= excluded.T
    solid = np.flatnonzero((model.geom_contype | model.geom_conaffinity) != 0)
    pairs = solid[np.transpose(np.triu_indices(len(solid), 1))]
    first, second = model.geom_bodyid[pairs].T
    moves = model.body_weldid[first] != model.body_weldid[second]
    return pairs[moves & ~excluded[first, second]].astype(np.int32)


def near_pairs(
    model: mujoco.MjModel, pairs: np.ndarray, lever: Floats, margins: Floats, prefix: str
) -> np.ndarray:
    """Return the pairs without those of a distant body, such as a wall, and a link.

    A body is distant if its name has the prefix and every link stays ``FAR_M`` and the body's
    margin away from it, wherever the joints stand.

    Args:
        model: the cell.
        pairs: geom ids, (p, 2).
        lever: bounds from ``levers``, m, (bodies, n).
        margins: additional gap of each geom, m, (geoms,).
        prefix: beginning of the names of bodies that may be left out.
    """
    mujoco = mujoco_module()
    may_go = np.array([model.body(b).name.startswith(prefix) for b in range(model.nbody)], bool)
    data, keep = mujoco.MjData(model), np.ones(len(pairs), bool)
    rail = model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE
    mujoco.mj_kinematics(model, data)
    of = may_go[model.geom_bodyid[pairs]]
    rows = np.flatnonzero(of.any(axis=1))
    standing = np.where(of[rows, 0], pairs[rows, 0], pairs[rows, 1])
    moving = model.geom_bodyid[np.where(of[rows, 0], pairs[rows, 1], pairs[rows, 0])]
    levers_of = lever[moving]
    hinges = (levers_of > 0) & ~rail
    first = hinges.argmax(axis=1)
    turn = data.geom_xmat[standing].reshape(-1, 3, 3)
    centre, half = np.split(model.geom_aabb[standing], 2, axis=1)
    apart = data.xanchor[first] - data.geom_xpos[standing]
    local = (apart[:, None] @ turn)[:, 0] - centre
    away = np.linalg.norm(np.maximum(np.abs(local) - half, 0), axis=1)
    travel = np.where((levers_of > 0) & rail, np.abs(model.jnt_range).max(axis=1), 0).sum(axis=1)
    reach = levers_of[np.arange(len(rows)), first] + travel
    near = away < reach + margins[standing] + FAR_M
    keep[rows] = near | ~hinges.any(axis=1)  # a carriage has no hinge
    return pairs[keep]


def levers(model: mujoco.MjModel) -> Floats:
    """Return the lengths of the chain from each joint to each body, with the body's own size.

    It is 1 for a rail, which moves each body by its own way.
    """
    rail = model.jnt_type == mujoco_module().mjtJoint.mjJNT_SLIDE
    size = np.zeros(model.nbody)
    for geom, body in enumerate(model.geom_bodyid):
        extent = model.geom_rbound[geom] + np.linalg.norm(model.geom_pos[geom])
        size[body] = max(size[body], float(extent))
    lever = np.zeros((model.nbody, model.njnt))
    for body in range(model.nbody):
        length, link = size[body], body
        while link != 0:
            for j in np.flatnonzero(model.jnt_bodyid == link):
                lever[body, j] = (
                    1.0 if rail[j] else length + float(np.linalg.norm(model.jnt_pos[j]))
                )
            length += float(np.linalg.norm(model.body_pos[link]))
            link = int(model.body_parentid[link])
    return lever
