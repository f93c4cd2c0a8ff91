"""Models of single arms, built in, from MuJoCo Menagerie or from a user, in one common form."""

from __future__ import annotations

import difflib
import os
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from twinct.core.errors import MissingExtraError, ScenarioError
from twinct.core.foreign_text import counted, quoted
from twinct.geometry import Floats, Pose
from twinct.robots.arm_files import BUILT_IN
from twinct.robots.cell._mujoco import mujoco_module
from twinct.robots.cell.flanges import FLANGE_SITES
from twinct.robots.cell.own_arms import OwnArm, read_own_arm
from twinct.robots.sections import Arm
from twinct.robots.sections.cell import known_arms

if TYPE_CHECKING:
    import mujoco


@dataclass(frozen=True, eq=False)
class ArmModel:
    """Model of one arm before it is placed in the cell.

    Attributes:
        spec: the arm alone, without actuators, keyframes and lights.
        joint_names: hinge joints from base to flange.
        flange_site: site at the tool flange, z away from the arm.
        torque_limits: N m, (joints,).
        speed_limits: rad/s, (joints,).
        home: start of the path search, rad, (joints,), if the scenario states one.
        notes: data that the scenario supplied in place of the file, in words.
        file_from_base: pose of the base in the model's world; None at the origin.
        files: files of a user's arm, with those that it names.
    """

    spec: mujoco.MjSpec
    joint_names: tuple[str, ...]
    flange_site: str
    torque_limits: Floats
    speed_limits: Floats
    home: Floats | None = None
    file_from_base: Pose | None = None
    notes: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()


def load_arm(arm: Arm, key: str) -> ArmModel:
    """Load the arm model that a scenario names.

    Args:
        arm: section of the arm; ``model`` or ``file`` names the model, and ``joint_speed_deg_s``
            gives speed limits that the model does not state.
        key: key of the section in the scenario, for messages.

    Raises:
        MissingExtraError: a Menagerie model is requested, and no copy of Menagerie is installed.
        ScenarioError: Menagerie has no such model, or the model is no single arm or lacks data
            that a cell needs.
    """
    mujoco = mujoco_module()
    name = arm.model
    if name is None:
        return _from_file(arm, key, f"{key}.file: {arm.file}")
    origin = f"{key}.model: {name}"
    if name.startswith("menagerie:"):
        spec = mujoco.MjSpec.from_file(str(_menagerie_file(name.removeprefix("menagerie:"), key)))
        return _normalised(spec, spec.compile(), arm, key, origin)
    if name in BUILT_IN:
        spec, model = _built_in(name)
        return _normalised(spec.copy(), model, arm, key, origin)
    offered = known_arms()[name]
    keys = {k: v for k, v in offered.keys.items() if k not in arm.model_fields_set}
    return _from_file(arm.model_copy(update={"file": offered.file, **keys}), key, origin)


_PLACED = (
    *("base_position_mm", "base_rotation_deg", "standoff_mm", "tool_rotation_deg"),
    *("rail", "turntable", "tool"),
)
"""Keys of an arm that its model does not depend on."""

_kept: dict[tuple[str, str], tuple[tuple[object, ...], ArmModel]] = {}


def _from_file(arm: Arm, key: str, origin: str) -> ArmModel:
    """Return an arm of a file; a search builds the same arms hundreds of times."""
    assert arm.file is not None
    keys = origin, arm.model_dump_json(exclude=set(_PLACED))
    if (known := _kept.get(keys)) is None or known[0] != _stamps(known[1].files):
        own = read_own_arm(arm, origin)
        model = _normalised(own.spec, own.spec.compile(), arm, key, origin, own)
        if len(_kept) >= _MOST_KEPT:
            _kept.clear()
        known = _kept[keys] = _stamps(model.files), model
    return replace(known[1], spec=known[1].spec.copy())


def _stamps(files: tuple[Path, ...]) -> tuple[object, ...]:
    """Return what changes when one of some files is written."""
    try:
        return tuple((status.st_mtime_ns, status.st_size) for status in map(os.stat, files))
    except OSError:
        return (object(),)  # equal to no other


_MOST_KEPT = 8


@cache
def _built_in(name: str) -> tuple[mujoco.MjSpec, mujoco.MjModel]:
    """Return an arm of this package; a search builds the same arms hundreds of times."""
    spec = mujoco_module().MjSpec.from_file(str(BUILT_IN[name].file))
    return spec, spec.compile()


def _menagerie_file(name: str, key: str) -> Path:
    root = os.environ.get("MENAGERIE_ROOT")
    if root:
        folder = Path(root) / name
        if not Path(root).is_dir():
            raise ScenarioError(f"{key}.model: MENAGERIE_ROOT={root} is not a folder")
        if not folder.is_dir():
            there = ", ".join(sorted(p.name for p in Path(root).glob("*/") if p.is_dir()))
            raise ScenarioError(
                f"{key}.model: MENAGERIE_ROOT={root} holds no model {quoted(name)}; it holds "
                f"{there or 'none'}"
            )
    else:
        try:
            import mujoco_menagerie
        except ImportError as error:
            advice = "or set MENAGERIE_ROOT to a copy of MuJoCo Menagerie"
            raise MissingExtraError("mujoco-menagerie", "menagerie", advice) from error
        try:
            folder = Path(mujoco_menagerie.get(name).path())
        except mujoco_menagerie.UnknownRobotError:
            names = list(mujoco_menagerie.names())
            near = difflib.get_close_matches(name, names, n=5, cutoff=0.3) or names
            raise ScenarioError(
                f"{key}.model: MuJoCo Menagerie has no model {quoted(name)}; the nearest of its "
                f"{len(names)}: {', '.join(near)}"
            ) from None
        except mujoco_menagerie.MenagerieError as error:
            raise ScenarioError(
                f"{key}.model: MuJoCo Menagerie's {quoted(name)} is not available: {error}; with "
                "no network, set MENAGERIE_ROOT to a copy of MuJoCo Menagerie, a folder with one "
                "folder for each model"
            ) from error
        if folder.is_file():
            folder = folder.parent
    # A model's folder also contains scenes, which include the robot, and variants for MJX.
    candidates = [p for p in sorted(folder.glob("*.xml")) if "scene" not in p.stem]
    plain = [p for p in candidates if not p.stem.endswith("_mjx")] or candidates
    if not plain:
        raise ScenarioError(f"{key}.model: {folder} holds no robot model (*.xml)")
    return min(plain, key=lambda path: len(path.stem))


def _normalised(
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    arm: Arm,
    key: str,
    origin: str,
    own: OwnArm | None = None,
) -> ArmModel:
    mujoco = mujoco_module()
    if model.njnt < 5 or (model.jnt_type != mujoco.mjtJoint.mjJNT_HINGE).any():
        raise ScenarioError(
            f"{origin} is not a single arm: it has {counted(model.njnt, 'joint')}; an arm needs "
            "five or more, all of them hinges"
        )
    if (np.diff(model.jnt_bodyid) <= 0).any() or not _is_chain(model):
        raise ScenarioError(f"{origin} is not a single arm: its joints do not form one chain")
    names = tuple(model.joint(i).name for i in range(model.njnt))
    if not all(names):
        raise ScenarioError(f"{origin} has joints without a name")
    lacking = list(own.lacking) if own else []
    torques, supplied, speeds = np.empty(0), (), np.empty(0)
    try:
        torques, supplied = _torques(model, names, arm, origin, own)
    except ScenarioError as error:
        lacking += error.problems
    try:
        speeds = _speed_limits(spec, names, arm, origin, own)
    except ScenarioError as error:
        lacking += error.problems
    if lacking:
        raise ScenarioError(lacking)
    home = _home(model, names, arm, key)
    flange = own.flange_site if own else _flange(spec, model)
    for group in ("actuators", "keys", "sensors", "lights", "cameras", "numerics"):
        for element in list(getattr(spec, group)):
            spec.delete(element)
    base = own.file_from_base if own else None
    notes = (*own.notes, *supplied) if own else ()
    files = own.files if own else ()
    return ArmModel(spec, names, flange, torques, np.radians(speeds), home, base, notes, files)


def _is_chain(model: mujoco.MjModel) -> bool:
    for inner, outer in zip(model.jnt_bodyid[:-1], model.jnt_bodyid[1:], strict=True):
        body = outer
        while body > inner:
            body = model.body_parentid[body]
        if body != inner:
            return False
    return True


def _torques(
    model: mujoco.MjModel, names: tuple[str, ...], arm: Arm, origin: str, own: OwnArm | None
) -> tuple[Floats, tuple[str, ...]]:
    """Return the torque limits of the model, or else of the scenario, with a note about these."""
    torques = _torque_limits(model)
    known = np.isfinite(torques) & (torques > 0)
    if known.all():
        return torques, ()
    bad = ", ".join(n for n, good in zip(names, known, strict=True) if not good)
    if arm.joint_torque_nm is None:
        cure = (
            " (MJCF: actuatorfrcrange, in N m; URDF: effort): write it into the file, or set the "
            "key joint_torque_nm"
        )
        raise ScenarioError(
            f"{origin} states no torque limit above 0 for {bad}{cure if own else ''}"
        )
    stated = np.atleast_1d(arm.joint_torque_nm)
    if len(stated) not in (1, len(names)):
        raise ScenarioError(
            f"{origin}: joint_torque_nm has {len(stated)} numbers; expected 1 or {len(names)}, one "
            f"for each of {', '.join(names)}"
        )
    values = ", ".join(f"{torque:g}" for torque in stated)
    note = f"torque limits of {bad}, from joint_torque_nm ({values} N m)"
    return np.where(known, torques, stated), (note,)


def _torque_limits(model: mujoco.MjModel) -> Floats:
    """Return the torque limit of each joint, the smaller of its own and its actuator's limits."""
    mujoco = mujoco_module()
    limits = np.full(model.njnt, np.inf)
    for j in range(model.njnt):
        if model.jnt_actfrclimited[j]:
            limits[j] = model.jnt_actfrcrange[j, 1]
    at_joint = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    for a in np.flatnonzero(np.isin(model.actuator_trntype, at_joint)):
        joint, gear = model.actuator_trnid[a, 0], abs(model.actuator_gear[a, 0])
        if model.actuator_forcelimited[a]:
            limits[joint] = min(limits[joint], gear * model.actuator_forcerange[a, 1])
        elif model.actuator_ctrllimited[a] and not model.actuator_biasprm[a].any():
            gain = model.actuator_gainprm[a, 0]  # a plain motor: torque is gain times control
            limits[joint] = min(limits[joint], gear * gain * model.actuator_ctrlrange[a, 1])
    return limits


def _speed_limits(
    spec: mujoco.MjSpec, names: tuple[str, ...], arm: Arm, origin: str, own: OwnArm | None
) -> Floats:
    """Return the speed limits of the model, or else of the scenario, deg/s."""
    key = "joint_speed_deg_s"
    if stated := [n for n in spec.numerics if n.name == key]:
        speeds = np.array(list(stated[0].data))
        if speeds.shape != (len(names),) or not (speeds > 0).all():
            raise ScenarioError(
                f"{origin}: its {key} holds {speeds.tolist()}; expected {len(names)} numbers "
                f"above 0, one for each of {', '.join(names)}"
            )
        return speeds
    urdf = own.speed_limits if own else {}
    unknown = [name for name in names if name not in urdf]
    if own and unknown and key not in arm.model_fields_set:
        raise ScenarioError(
            f"{origin} states no speed limit for {', '.join(unknown)}: set {key} beside the file, "
            f"or write it into the file (URDF: velocity in rad/s; MJCF: <custom><numeric "
            f'name="{key}" data="..."/></custom>)'
        )
    return np.array([np.degrees(urdf[n]) if n in urdf else arm.joint_speed_deg_s for n in names])


def _home(model: mujoco.MjModel, names: tuple[str, ...], arm: Arm, key: str) -> Floats | None:
    if arm.home is None:
        return None
    if len(arm.home) != len(names):
        raise ScenarioError(
            f"{key}.home: has {len(arm.home)} numbers, but the arm has "
            f"{counted(len(names), 'joint')}: {', '.join(names)}"
        )
    outside = [
        f"{value:g} for {name}, whose range is {low:g} to {high:g}"
        for value, name, (low, high) in zip(
            arm.home, names, np.degrees(model.jnt_range), strict=True
        )
        if not low <= value <= high
    ]
    if outside:
        raise ScenarioError(f"{key}.home: outside the joint's range (deg): {'; '.join(outside)}")
    return np.radians(arm.home)


def _flange(spec: mujoco.MjSpec, model: mujoco.MjModel) -> str:
    names = [model.site(i).name for i in range(model.nsite)]
    for name in (*FLANGE_SITES, *(n for n in names if "attach" in n or "flange" in n)):
        if name in names:
            return name
    spec.body(model.body(model.nbody - 1).name).add_site(name="flange")
    return "flange"
