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
from twinct.robots.cell.flanges import flange_of
from twinct.robots.cell.structural_pairs import exclude, exclude_stated, exclude_structural
from twinct.robots.cell.urdf_tree import Reduced, arm_alone
from twinct.robots.sections import Arm

if TYPE_CHECKING:
    import mujoco

OF_THE_CELL = ("carriage", "pedestal", "tool_mount", "track", "turntable", "turntable_foot")
"""Names of bodies that the cell gives an arm; a link of such a name gets another one."""

DEFAULT_DENSITY = 1000.0
"""Density that MuJoCo assumes for a shape whose file states none, kg/m^3."""

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
    alone = arm_alone(xml.text, arm.flange) if xml.is_urdf else Reduced(xml.text, ())
    try:
        spec = mujoco.MjSpec.from_string(alone.text)
        for body in spec.bodies:
            if body.name in OF_THE_CELL:
                body.name += "_link"
        model = spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        reason = " ".join(str(error).split())
        raise ScenarioError(f"{where} is not a model that MuJoCo can read: {reason}") from None
    _check(model, where)
    _check_sizes(model, where)
    notes = (*alone.notes, *_unchecked(spec, model, arm, alone, where))
    if xml.is_urdf:
        notes += exclude_structural(spec, spec.compile())
    weighed, lacking = _weigh(spec, model, arm, xml.is_urdf, where)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    base = _base(model, data, arm.base, where)
    _show_visuals(spec, model)
    flange, told = flange_of(spec, model, data, arm.flange, xml.is_urdf, where)
    notes = (*notes, *told, *weighed)
    return OwnArm(spec, flange, xml.speed_limits, base, notes, xml.files, lacking)


def _unchecked(
    spec: mujoco.MjSpec, model: mujoco.MjModel, arm: Arm, alone: Reduced, where: str
) -> tuple[str, ...]:
    """Exclude pairs of links that file or scenario name, and linkages, from the checks."""
    bodies = [model.body(body) for body in range(1, model.nbody)]
    links = [body.name for body in bodies if model.body_weldid[body.id] == body.id]
    for linkage in alone.linkages:
        for link in links:
            exclude(spec, model, model.body(linkage).id, model.body(link).id)
    return (
        *exclude_stated(spec, model, alone.disabled, "its disable_collisions", where),
        *exclude_stated(spec, model, arm.ignore_pairs, "the key ignore_pairs", where),
    )


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
