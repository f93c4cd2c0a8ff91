"""The flange of an arm from a file: by the name that somebody gives, a usual name, or the tree."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from twinct.core.errors import ScenarioError
from twinct.core.foreign_text import quoted
from twinct.geometry import Floats
from twinct.robots.cell._mujoco import mujoco_module
from twinct.robots.cell.urdf_tree import FLANGE_LINKS

if TYPE_CHECKING:
    import mujoco

FLANGE_SITES = ("flange", "attachment_site", "attachment")
"""Names of the tool flange in MJCF models, in order of preference."""

ALONG, ROUNDING_M = 0.99, 1e-6
"""Limits for z of an unnamed flange: cosine to the last joint's axis, and offset inwards."""

ON_AXIS_M = 0.001
"""Largest distance of the flange's origin from the last joint's axis, and least from the wrist."""

FLANGE_SITE = "twinct_flange"
"""Name of the site that is added to a flange that is a body."""


def flange_of(
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    wanted: str | None,
    is_urdf: bool,
    where: str,
) -> tuple[str, tuple[str, ...]]:
    """Return the name of the flange site, and a note if the tree decided; add a site if needed.

    Args:
        spec: the arm.
        model: its compiled form.
        data: kinematics at 0.
        wanted: site, body or link that the scenario names.
        is_urdf: whether the file is a URDF.
        where: name of the file in messages.

    Raises:
        ScenarioError: there is no flange, or it cannot be one.
    """
    bodies = [model.body(b).name for b in range(1, model.nbody)]
    sites = [model.site(s).name for s in range(model.nsite)]
    usual, places = (FLANGE_LINKS, bodies) if is_urdf else (FLANGE_SITES, sites)
    name = wanted or next((name for name in usual if name in places), None)
    if name is None and is_urdf and model.njnt:
        return _end_of_tree(spec, model, data)
    if name is None or name not in (*sites, *bodies):
        lacks = f"no flange {quoted(name)}" if name else f"no flange, such as {' or '.join(usual)}"
        raise ScenarioError(
            f"{where} has {lacks}: set the key flange to one of "
            f"{', '.join(filter(None, (*sites, *bodies)))}"
        )
    body = model.site(name).bodyid[0] if name in sites else model.body(name).id
    place = data.site(name) if name in sites else data.body(name)
    last = model.jnt_bodyid[-1]
    if model.body_weldid[body] != last:
        raise ScenarioError(
            f"{where}: flange {quoted(name)} is not part of the last link, {model.body(last).name}"
        )
    z = place.xmat.reshape(3, 3)[:, 2]
    outwards = (place.xpos - data.xanchor[-1]) @ z
    if not wanted and (abs(data.xaxis[-1] @ z) < ALONG or outwards < -ROUNDING_M):
        raise ScenarioError(
            f"{where}: z of its flange {quoted(name)} does not point along the last joint's axis, "
            "away from the arm: set the key flange to a frame whose z points towards the tool"
        )
    if name in sites:
        return name, ()
    spec.body(name).add_site(name=FLANGE_SITE)
    return FLANGE_SITE, ()


def _end_of_tree(
    spec: mujoco.MjSpec, model: mujoco.MjModel, data: mujoco.MjData
) -> tuple[str, tuple[str, ...]]:
    """Add a site at the end of the last link, whose z is the last joint's axis, outwards.

    Outwards is away from the joint before. If the two meet, as in a wrist, it is towards the shapes
    of the last link. The site lies at the farthest frame of the link on the axis, or at the face of
    its shapes if all frames lie in the wrist.
    """
    last = int(model.jnt_bodyid[-1])
    axis, origin = data.xaxis[-1], data.xanchor[-1]
    from_before = float((origin - data.xanchor[-2]) @ axis) if model.njnt > 1 else 0.0
    pieces = np.flatnonzero(model.body_weldid == last)
    ends = _ends(model, data, pieces, axis, data.xanchor[-2] if model.njnt > 1 else origin)
    middle = sum(ends) / 2 if ends else 0.0
    way = from_before if abs(from_before) > ON_AXIS_M else middle
    axis = axis * (1.0 if way >= 0 else -1.0)
    wrist = data.xanchor[-2] if model.njnt > 1 else origin
    along = (data.xpos[pieces] - wrist) @ axis
    beside = np.linalg.norm(_across(data.xpos[pieces] - origin, axis), axis=1)
    fit = np.flatnonzero((beside < ON_AXIS_M) & (along > ON_AXIS_M))
    if len(fit):
        aligned = data.xmat[pieces].reshape(-1, 3, 3)[:, :, 2] @ axis
        body = int(pieces[max(fit, key=lambda k: (round(float(along[k]), 6), aligned[k]))])
        far, told = float(along[fit].max()), f"the origin of {model.body(body).name}"
    else:
        body = last
        far = max((way >= 0 and ends[1]) or -ends[0] if ends else 0.0, 0.0)
        told = f"the face of {model.body(last).name}"
    place = origin + axis * (far - float((origin - wrist) @ axis))
    turned = _frame(axis, data.xmat[body].reshape(3, 3))
    local = data.xmat[body].reshape(3, 3).T
    quat = np.zeros(4)
    mujoco_module().mju_mat2Quat(quat, (local @ turned).ravel())
    name = model.body(body).name
    spec.body(name).add_site(name=FLANGE_SITE, pos=local @ (place - data.xpos[body]), quat=quat)
    joint = model.joint(model.njnt - 1).name
    return FLANGE_SITE, (f"flange at the end of the tree: {told}, z along the axis of {joint}",)


def _across(vectors: Floats, axis: Floats) -> Floats:
    return np.asarray(vectors - (vectors @ axis)[:, None] * axis, dtype=np.float64)


def _ends(
    model: mujoco.MjModel, data: mujoco.MjData, pieces: np.ndarray, axis: Floats, origin: Floats
) -> tuple[float, float] | None:
    """Return how far the shapes of a link reach along an axis, to both sides of a point."""
    low, high = np.inf, -np.inf
    for geom in np.flatnonzero(np.isin(model.geom_bodyid, pieces)):
        turn = data.geom_xmat[geom].reshape(3, 3)
        centre, half = np.split(model.geom_aabb[geom], 2)
        middle = float((data.geom_xpos[geom] + turn @ centre - origin) @ axis)
        reach = float(np.abs(axis @ turn) @ half)
        low, high = min(low, middle - reach), max(high, middle + reach)
    return None if low > high else (low, high)


def _frame(z: Floats, near: Floats) -> Floats:
    """Return the axes of a frame with z as given, and x as close as possible to another's."""
    x = near[:, 0] - (near[:, 0] @ z) * z
    if np.linalg.norm(x) < 0.1:
        x = near[:, 1] - (near[:, 1] @ z) * z
    x = x / np.linalg.norm(x)
    axes: Any = [x, np.cross(z, x), z]
    return np.asarray(np.stack(axes, axis=1), dtype=np.float64)
