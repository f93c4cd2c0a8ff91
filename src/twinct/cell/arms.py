"""Single arms: our own MJCF files and models of MuJoCo Menagerie, brought to one form."""

from __future__ import annotations

import difflib
import os
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from twinct.cell._mujoco import mujoco_module
from twinct.errors import MissingExtraError, ScenarioError
from twinct.geometry import Floats
from twinct.scenario import Arm

if TYPE_CHECKING:
    import mujoco

FLANGE_SITES = ("flange", "attachment_site", "attachment")
"""Names by which arm models call the place where a tool is bolted on, in order of preference."""


@dataclass(frozen=True, eq=False)
class ArmModel:
    """One arm before it is placed in the room.

    Attributes:
        spec: the arm alone, without actuators, keyframes and lights.
        joint_names: hinge joints from base to flange.
        flange_site: site at the tool flange, z away from the arm.
        torque_limits: N m, (joints,).
        speed_limits: rad/s, (joints,).
    """

    spec: mujoco.MjSpec
    joint_names: tuple[str, ...]
    flange_site: str
    torque_limits: Floats
    speed_limits: Floats


def load_arm(arm: Arm, key: str) -> ArmModel:
    """Load the model that a scenario names.

    Args:
        arm: the section; ``model`` names the file, ``joint_speed_deg_s`` fills in what a Menagerie
            model does not state.
        key: where the section stands in the scenario, for messages.

    Raises:
        MissingExtraError: a Menagerie model is asked for and there is no copy of Menagerie.
        ScenarioError: Menagerie holds no such model, or it is no single arm.
    """
    mujoco = mujoco_module()
    name = arm.model
    if name.startswith("menagerie:"):
        spec = mujoco.MjSpec.from_file(str(_menagerie_file(name.removeprefix("menagerie:"), key)))
    else:
        with as_file(files("twinct.cell") / f"{name}.xml") as path:
            spec = mujoco.MjSpec.from_file(str(path))
    return _normalised(spec, arm, f"{key}.model: {name}")


def _menagerie_file(name: str, key: str) -> Path:
    root = os.environ.get("MENAGERIE_ROOT")
    if root:
        folder = Path(root) / name
        if not Path(root).is_dir():
            raise ScenarioError(f"{key}.model: MENAGERIE_ROOT={root} is no folder")
        if not folder.is_dir():
            there = ", ".join(sorted(p.name for p in Path(root).glob("*/") if p.is_dir()))
            raise ScenarioError(
                f"{key}.model: MENAGERIE_ROOT={root} holds no model {name!r}; it holds "
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
                f"{key}.model: MuJoCo Menagerie holds no model {name!r}; the nearest of its "
                f"{len(names)}: {', '.join(near)}"
            ) from None
        except mujoco_menagerie.MenagerieError as error:
            raise ScenarioError(f"{key}.model: {error}") from error
        if folder.is_file():
            folder = folder.parent
    # A model's folder holds scenes, which include the robot, and variants for other simulators.
    candidates = [p for p in sorted(folder.glob("*.xml")) if "scene" not in p.stem]
    plain = [p for p in candidates if not p.stem.endswith("_mjx")] or candidates
    if not plain:
        raise ScenarioError(f"{key}.model: {folder} holds no robot model (*.xml)")
    return min(plain, key=lambda path: len(path.stem))


def _normalised(spec: mujoco.MjSpec, arm: Arm, origin: str) -> ArmModel:
    mujoco = mujoco_module()
    model = spec.compile()
    if model.njnt < 5 or (model.jnt_type != mujoco.mjtJoint.mjJNT_HINGE).any():
        raise ScenarioError(
            f"{origin} is no single arm: it has {model.njnt} joints, and an arm has five or more "
            "hinges and nothing else"
        )
    if (np.diff(model.jnt_bodyid) <= 0).any() or not _is_chain(model):
        raise ScenarioError(f"{origin} is no single arm: its joints are not one chain")
    names = tuple(model.joint(i).name for i in range(model.njnt))
    if not all(names):
        raise ScenarioError(f"{origin} has joints without a name")
    torques = _torque_limits(model)
    if not np.isfinite(torques).all():
        bad = ", ".join(n for n, t in zip(names, torques, strict=True) if not np.isfinite(t))
        raise ScenarioError(f"{origin} states no torque limit for {bad}")
    stated = [list(n.data) for n in spec.numerics if n.name == "joint_speed_deg_s"]
    speeds = np.array(stated[0] if stated else [arm.joint_speed_deg_s] * model.njnt)
    flange = _flange(spec, model)
    for group in ("actuators", "keys", "sensors", "lights", "cameras", "numerics"):
        for element in list(getattr(spec, group)):
            spec.delete(element)
    return ArmModel(spec, names, flange, torques, np.radians(speeds))


def _is_chain(model: mujoco.MjModel) -> bool:
    for inner, outer in zip(model.jnt_bodyid[:-1], model.jnt_bodyid[1:], strict=True):
        body = outer
        while body > inner:
            body = model.body_parentid[body]
        if body != inner:
            return False
    return True


def _torque_limits(model: mujoco.MjModel) -> Floats:
    """The joint's own limit, else what its actuator can give."""
    limits = np.full(model.njnt, np.inf)
    for j in range(model.njnt):
        if model.jnt_actfrclimited[j]:
            limits[j] = model.jnt_actfrcrange[j, 1]
    for a in range(model.nu):
        joint, gear = model.actuator_trnid[a, 0], abs(model.actuator_gear[a, 0])
        if model.actuator_forcelimited[a]:
            limits[joint] = min(limits[joint], gear * model.actuator_forcerange[a, 1])
        elif model.actuator_ctrllimited[a] and not model.actuator_biasprm[a].any():
            gain = model.actuator_gainprm[a, 0]  # a plain motor: torque is gain times control
            limits[joint] = min(limits[joint], gear * gain * model.actuator_ctrlrange[a, 1])
    return limits


def _flange(spec: mujoco.MjSpec, model: mujoco.MjModel) -> str:
    names = [model.site(i).name for i in range(model.nsite)]
    for name in (*FLANGE_SITES, *(n for n in names if "attach" in n or "flange" in n)):
        if name in names:
            return name
    spec.body(model.body(model.nbody - 1).name).add_site(name="flange")
    return "flange"
