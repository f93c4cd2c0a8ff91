"""Arm models from a user's files: reading, and checks of the data that a cell needs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from twinct.core.errors import ScenarioError
from twinct.core.files.arm_xml import read_arm_xml
from twinct.core.foreign_text import quoted
from twinct.geometry import Pose
from twinct.robots.cell._mujoco import mujoco_module
from twinct.robots.cell.urdf_tree import FLANGE_LINKS, Reduced, arm_alone
from twinct.robots.sections import Arm

if TYPE_CHECKING:
    import mujoco

FLANGE_SITES = ("flange", "attachment_site", "attachment")
"""Names of the tool flange in MJCF models, in order of preference."""

ALONG, ROUNDING_M = 0.99, 1e-6
"""Limits for z of an unnamed flange: cosine to the last joint's axis, and offset inwards."""

FLANGE_SITE = "twinct_flange"
"""Name of the site that is added to a flange that is a body."""

DEFAULT_DENSITY = 1000.0
"""Density that MuJoCo assumes for a shape whose file states none, kg/m^3."""

OVERLAPS_TRIED = 100
"""Random configurations in which the hulls of two links must overlap to be excluded."""

IN_SCALE = 1 / 300, 20.0
"""Least and largest ratio of the largest mesh to the arm's length, if they share a unit."""

_HIDDEN_GROUP = 3


@dataclass(frozen=True, eq=False)
class OwnArm:
    """Arm from a user's file, with data beyond MuJoCo's model.

    Attributes:
        spec: the arm as the file describes it.
        flange_site: site at the tool flange.
        speed_limits: rad/s by joint, if stated.
        file_from_base: pose of the base in the file's world.
        notes: data that the scenario supplied in place of the file, in words.
        files: the file, and all files that it names.
        lacking: refusal of links without inertia, for one message with the limits that lack.
    """

    spec: mujoco.MjSpec
    flange_site: str
    speed_limits: dict[str, float]
    file_from_base: Pose
    notes: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()
    lacking: tuple[str, ...] = ()


def read_own_arm(arm: Arm, where: str) -> OwnArm:
    """Read and check the arm file that a scenario names.

    Args:
        arm: section of the arm, with ``file``.
        where: name of the file in messages.

    Raises:
        ScenarioError: the file cannot be read, or lacks data that a cell needs, other than inertia
            and limits.
    """
    mujoco = mujoco_module()
    assert arm.file is not None
    xml = read_arm_xml(arm.file, where)
    alone = arm_alone(xml.text, arm.flange, where) if xml.is_urdf else Reduced(xml.text, ())
    try:
        spec = mujoco.MjSpec.from_string(alone.text)
        balanced = _balanced(spec) if xml.is_urdf else ()
        model = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        reason = " ".join(str(error).split())
        raise ScenarioError(f"{where} is not a model that MuJoCo can read: {reason}") from None
    _check(model, where)
    _check_sizes(model, where)
    within = _within_each_other(spec, model) if xml.is_urdf else ()
    weighed, lacking = _weigh(spec, model, arm, xml.is_urdf, where)
    notes = (*alone.notes, *balanced, *within, *weighed)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    base = _base(model, data, arm.base, where)
    _show_visuals(spec, model)
    flange = _flange(spec, model, data, arm.flange, xml.is_urdf, where)
    return OwnArm(spec, flange, xml.speed_limits, base, notes, xml.files, lacking)


def _check(model: mujoco.MjModel, where: str) -> None:
    mujoco = mujoco_module()
    joints = [model.joint(j).name or f"number {j}" for j in range(model.njnt)]
    if not joints:
        raise ScenarioError(f"{where} is not an arm: it has no joints")
    if others := [
        n for n, t in zip(joints, model.jnt_type, strict=True) if t != mujoco.mjtJoint.mjJNT_HINGE
    ]:
        raise ScenarioError(
            f"{where} is not a single arm: all joints must be hinges, but these are not: "
            f"{', '.join(others)}"
        )
    if not all(model.body(b).name for b in range(model.nbody)):
        raise ScenarioError(f"{where} has bodies without a name")
    if model.body_geomnum[0]:
        raise ScenarioError(
            f"{where} has shapes outside any body, such as the floor of a scene: name a file "
            "of the arm alone"
        )
    if model.neq:
        raise ScenarioError(f"{where} couples joints (equality, mimic); each must move alone")
    if free := [n for n, limited in zip(joints, model.jnt_limited, strict=True) if not limited]:
        raise ScenarioError(
            f"{where} states no range for {', '.join(free)}: give it limits (MJCF: range; URDF: "
            "type revolute with lower and upper)"
        )
    solid = (model.geom_contype | model.geom_conaffinity) != 0
    links = model.body_weldid[model.geom_bodyid[solid]]
    if bare := [model.body(b).name for b in dict.fromkeys(model.jnt_bodyid) if b not in links]:
        raise ScenarioError(
            f"{where} has no collision geometry on {', '.join(bare)}: without it, collisions would "
            "go unnoticed"
        )


def _balanced(spec: mujoco.MjSpec) -> tuple[str, ...]:
    """Let MuJoCo mend moments of inertia that no body can have, and return a note about them."""
    try:
        spec.compile()
    except (ValueError, mujoco_module().FatalError) as error:
        if "balanceinertia" not in str(error):
            raise
        spec.compiler.balanceinertia = True
        return ("moments of inertia that no body can have, made equal in each such link",)
    return ()


def _check_sizes(model: mujoco.MjModel, where: str) -> None:
    """Refuse meshes in another unit than m, which URDF and MJCF share."""
    mujoco = mujoco_module()
    meshes = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)
    sizes = 2 * np.linalg.norm(model.geom_aabb[meshes, 3:], axis=1)
    between = np.linalg.norm(model.body_pos[1:], axis=1)
    arm = float(between[model.body_weldid[1:] != 0].sum())
    if not len(meshes) or arm <= 0:
        return
    geom = int(meshes[sizes.argmax()])
    check_scale(model.mesh(model.geom_dataid[geom]).name, float(sizes.max()), arm, where)


def check_scale(name: str, largest: float, arm: float, where: str) -> None:
    """Refuse the largest mesh of an arm if it is not in m.

    Args:
        name: the mesh.
        largest: its diagonal with its scale, m.
        arm: sum of the distances between joints, m.
        where: name of the file in messages.

    Raises:
        ScenarioError: the mesh is far larger or smaller than the links.
    """
    if not IN_SCALE[0] < largest / arm < IN_SCALE[1]:
        unit, factor = ("mm", "0.001") if largest > arm else ("m already", "1")
        raise ScenarioError(
            f"{where}: its largest mesh, {name}, has a diagonal of {largest:.3g} m, where the "
            f"links are {arm:.3g} m long in total: the mesh is probably in {unit}. Set its scale "
            f'to "{factor} {factor} {factor}"'
        )


def _within_each_other(spec: mujoco.MjSpec, model: mujoco.MjModel) -> tuple[str, ...]:
    """Exclude pairs of links that overlap in every configuration, and return a note about them.

    The convex hull of a forked link contains the link in its fork. As such a pair can never be
    clear, its overlap says nothing, which is how MoveIt's setup treats it, too.
    """
    mujoco = mujoco_module()
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    low, high = model.jnt_range.T
    solid = np.flatnonzero((model.geom_contype | model.geom_conaffinity) != 0)
    links = model.body_weldid[model.geom_bodyid]
    above = model.body_weldid[model.body_parentid[links]]
    pairs = [
        (a, b)
        for k, a in enumerate(solid.tolist())
        for b in solid[k + 1 :].tolist()
        if links[a] != links[b] and above[a] != links[b] and above[b] != links[a]
    ]
    always = {tuple(sorted((int(links[a]), int(links[b])))): False for a, b in pairs}
    for _ in range(OVERLAPS_TRIED):
        data.qpos[:] = rng.uniform(low, high)
        mujoco.mj_kinematics(model, data)
        touching = {
            tuple(sorted((int(links[a]), int(links[b]))))
            for a, b in pairs
            if mujoco.mj_geomDistance(model, data, a, b, 0.001, None) < 0
        }
        always = {pair: True for pair in always if pair in touching}
    named = [tuple(model.body(link).name for link in pair) for pair in always]
    for one, other in named:
        spec.add_exclude(bodyname1=one, bodyname2=other)
    if not named:
        return ()
    in_words = ", ".join(f"{one} and {other}" for one, other in named)
    return (f"not checked against each other, as their hulls overlap in every pose: {in_words}",)


def _weigh(
    spec: mujoco.MjSpec, model: mujoco.MjModel, arm: Arm, is_urdf: bool, where: str
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Give links without inertia that of their collision shapes.

    MJCF defines a default density, URDF does not.

    Returns:
        A note about these links, and the refusal of links without inertia if neither the URDF nor
        the scenario states it.
    """
    if spec.compiler.inertiafromgeom == mujoco_module().mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE:
        return (), ()
    pieces: dict[int, list[Any]] = {}
    for body in spec.bodies[1:]:
        pieces.setdefault(int(model.body_weldid[body.id]), []).append(body)
    pieces.pop(0, None)  # the base does not move
    bare = {link: of for link, of in pieces.items() if not any(_has_mass(body) for body in of)}
    if not bare:
        return (), ()
    names = ", ".join(model.body(link).name for link in bare)
    density, origin = arm.link_density_kg_m3, "link_density_kg_m3"
    if density is None and not is_urdf:
        density, origin = DEFAULT_DENSITY, "MJCF's default density"
    if density is None:
        return (), (
            f"{where} states no inertia for {names}: without it, torques would be wrong. Write it "
            "into the file (<inertial>), or set the key link_density_kg_m3, from which these links "
            "get the inertia of their collision shapes",
        )
    for body in (body for of in bare.values() for body in of):
        for geom in body.geoms:
            geom.density = density if geom.contype or geom.conaffinity else 0.0
    heavy = spec.compile()
    mass = sum(float(heavy.body_mass[body.id]) for of in bare.values() for body in of)
    return (f"{names}: {mass:.2f} kg, from {origin} ({density:g} kg/m^3)",), ()


def _has_mass(body: Any) -> bool:
    """Return True if a body's file states its inertia, or the mass of its shapes."""
    stated = (geom.density not in (0.0, DEFAULT_DENSITY) for geom in body.geoms)
    return bool(body.explicitinertial) or any(stated) or any(g.mass > 0 for g in body.geoms)


def _base(model: mujoco.MjModel, data: mujoco.MjData, wanted: str | None, where: str) -> Pose:
    """Return the pose of the base in the file's world."""
    names = [model.body(b).name for b in range(model.nbody)]
    name = wanted or names[1]
    if name not in names:
        raise ScenarioError(f"{where} has no base {quoted(name)}; it has {', '.join(names[1:])}")
    if model.body_weldid[names.index(name)] != 0:
        raise ScenarioError(
            f"{where}: base {quoted(name)} is moved by joints: set the key base to a body "
            "that stands "
            "still, or to world for the file's origin"
        )
    return Pose.from_metres(data.body(name).xpos, np.roll(data.body(name).xquat, -1))


def _show_visuals(spec: mujoco.MjSpec, model: mujoco.MjModel) -> None:
    """Hide the collision shapes of links that have visual shapes."""
    solid = (model.geom_contype | model.geom_conaffinity) != 0
    seen = set(model.geom_bodyid[~solid & (model.geom_group < _HIDDEN_GROUP)])
    for geom, is_solid, body in zip(spec.geoms, solid, model.geom_bodyid, strict=True):
        if is_solid and body in seen:
            geom.group = _HIDDEN_GROUP


def _flange(
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    data: mujoco.MjData,
    wanted: str | None,
    is_urdf: bool,
    where: str,
) -> str:
    """Return the name of the flange site; add a site if the flange is a body."""
    bodies = [model.body(b).name for b in range(1, model.nbody)]
    sites = [model.site(s).name for s in range(model.nsite)]
    usual, places = (FLANGE_LINKS, bodies) if is_urdf else (FLANGE_SITES, sites)
    name = wanted or next((name for name in usual if name in places), None)
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
            f"{where}: z of its flange {quoted(name)} does not point along the last joint's "
            "axis, away "
            "from the arm: set the key flange to a frame whose z points towards the tool"
        )
    if name in sites:
        return name
    spec.body(name).add_site(name=FLANGE_SITE)
    return FLANGE_SITE
