"""The room as one MuJoCo model, composed from a scenario's ``cell`` section."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from twinct.cell._mujoco import mujoco_module
from twinct.cell.arms import ArmModel, load_arm
from twinct.errors import ScenarioError
from twinct.geometry import MM_PER_M, Floats, Panel, Pose
from twinct.scenario import Arm, Cell

if TYPE_CHECKING:
    import mujoco
    import trimesh

ARMS = ("source", "detector")
"""Prefixes of the two arms, in the order of joints, actuators and everything that is stacked."""

MM = 1 / MM_PER_M

VISUAL_GROUP, COLLISION_GROUP = 2, 3
"""Shown and solid where a geom is both; invisible collision shapes are in the second."""

BANDWIDTH_RAD_S = 80.0
"""Natural frequency of the joint servos; a damped one settles a millimetre step in 0.1 s."""

PANEL_BORDER_MM = 10.0
PANEL_DEPTH_MM = 24.0
PANEL_COVER_MM = 4.0
"""Housing about the active area: a border all round, so deep, so much of it before the pixels."""


LARGEST_PICTURE = (3840, 2400)
"""Pixels, width and height, for which MuJoCo sets memory aside."""


@dataclass(frozen=True, eq=False)
class CellModel:
    """The compiled room and where things are in it.

    Every joint is a hinge; joints, actuators and all arrays here are in the order source arm, then
    detector arm, from base to flange.

    Attributes:
        model: MuJoCo's model, metres.
        cell: the section it was built from.
        panel: the pixel lattice the housing was built about.
        joint_names: prefixed ``source_`` and ``detector_``.
        arm_joints: slice of the joints of each arm.
        site_ids: sites ``source`` and ``detector``; their frames are the design's.
        specimen_body: body id of ``specimen``.
        torque_limits: what the arms may use (published limit times ``torque_scale``), N m, (n,).
        speed_limits: published joint speeds, rad/s, (n,).
        speed_scales: share of them that a move may use, (n,).
        pairs: geom ids of all pairs of non-adjacent bodies that can move against each other,
            (p, 2).
        lever: bound on the distance of any point of a body from a joint's axis, m, (bodies, n);
            zero where the joint does not move the body.
    """

    model: mujoco.MjModel
    cell: Cell
    panel: Panel
    joint_names: tuple[str, ...]
    arm_joints: tuple[slice, slice]
    site_ids: tuple[int, int]
    specimen_body: int
    torque_limits: Floats
    speed_limits: Floats
    speed_scales: Floats
    pairs: np.ndarray
    lever: Floats

    @property
    def joint_ranges(self) -> Floats:
        """Lowest and highest position of each joint, rad, (n, 2)."""
        return self.model.jnt_range.copy()

    def body_of_geom(self, geom: int) -> str:
        """Name of the body that a geom belongs to."""
        return self.model.body(self.model.geom_bodyid[geom]).name


def build_cell(
    cell: Cell, specimen_mesh: trimesh.Trimesh | None, world_from_specimen: Pose, panel: Panel
) -> CellModel:
    """Compose and compile the room.

    Args:
        cell: arms, table, floor.
        specimen_mesh: surface in the specimen's frame, mm; its convex hull is what collides. None
            leaves the holder empty.
        world_from_specimen: where the specimen stands.
        panel: the pixel lattice; the housing follows its size.

    Raises:
        MissingExtraError: MuJoCo, or Menagerie where it is asked for, is not installed.
        ScenarioError: an arm or a measure that cannot be built.
    """
    mujoco = mujoco_module()
    spec = mujoco.MjSpec()
    spec.modelname = "twinct"
    spec.option.timestep = cell.timestep_ms / 1000
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.compiler.degree = False
    spec.compiler.autolimits = True
    _look(spec)
    _room(spec, cell)
    bottom_mm = _specimen(spec, cell, specimen_mesh, world_from_specimen)
    _table(spec, cell, world_from_specimen, bottom_mm)
    arms = []
    for side, arm in zip(ARMS, (cell.source_arm, cell.detector_arm), strict=True):
        loaded = load_arm(arm, f"cell.{side}_arm")
        _mount(spec, cell, side, arm, loaded)
        tool = spec.body(f"{side}_tool_mount").add_body(name=side)
        (_source_tool if side == "source" else _panel_tool)(tool, arm, panel)
        arms.append(loaded)
    names = _servos(spec, arms, cell)
    _exclude_adjacent(spec)
    # Per joint: position, velocity and acceleration of the reference that the servos follow.
    spec.nuserdata = 3 * len(names)
    return _compiled(spec, cell, panel, arms, names)


def _box(parent: Any, name: str, centre_mm: Any, size_mm: Any, material: str, **more: Any) -> None:
    parent.add_geom(
        name=name,
        type=mujoco_module().mjtGeom.mjGEOM_BOX,
        pos=np.asarray(centre_mm, dtype=float) * MM,
        size=np.asarray(size_mm, dtype=float) / 2 * MM,
        material=material,
        group=VISUAL_GROUP,
        **more,
    )


def _rod(
    parent: Any, name: str, start_mm: Any, end_mm: Any, radius_mm: float, material: str, **more: Any
) -> None:
    parent.add_geom(
        name=name,
        type=mujoco_module().mjtGeom.mjGEOM_CYLINDER,
        fromto=np.concatenate([start_mm, end_mm]).astype(float) * MM,
        size=[radius_mm * MM, 0, 0],
        material=material,
        group=VISUAL_GROUP,
        **more,
    )


def _look(spec: mujoco.MjSpec) -> None:
    mujoco = mujoco_module()
    spec.visual.global_.offwidth, spec.visual.global_.offheight = LARGEST_PICTURE
    spec.visual.quality.shadowsize = 4096
    spec.visual.quality.offsamples = 4
    spec.visual.headlight.ambient = [0.34, 0.34, 0.36]
    spec.visual.headlight.diffuse = [0.30, 0.30, 0.30]
    spec.visual.headlight.specular = [0.08, 0.08, 0.08]
    spec.visual.map.znear, spec.visual.map.zfar = 0.02, 60
    spec.visual.map.shadowclip = 3
    spec.visual.map.fogstart, spec.visual.map.fogend = 2, 8
    spec.visual.rgba.fog = [0.93, 0.95, 0.97, 1]
    spec.visual.rgba.haze = [0.93, 0.95, 0.97, 1]
    spec.stat.center, spec.stat.extent = [0, 0, -0.2], 2.0
    texture = mujoco.mjtTexture
    spec.add_texture(
        name="sky",
        type=texture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.93, 0.95, 0.97],
        rgb2=[0.70, 0.76, 0.82],
        width=256,
        height=1536,
    )
    spec.add_texture(
        name="tiles",
        type=texture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        mark=mujoco.mjtMark.mjMARK_EDGE,
        rgb1=[0.47, 0.53, 0.56],
        rgb2=[0.45, 0.51, 0.54],
        markrgb=[0.38, 0.43, 0.46],
        width=512,
        height=512,
    )
    floor = spec.add_material(name="floor", specular=0.1, shininess=0.3)
    floor.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "tiles"
    floor.texrepeat = [1, 1]
    floor.texuniform = True
    for name, rgba, specular, reflectance in (
        ("steel", [0.70, 0.72, 0.74, 1], 0.6, 0.1),
        ("pedestal", [0.30, 0.33, 0.37, 1], 0.3, 0.0),
        ("tabletop", [0.13, 0.15, 0.18, 1], 0.5, 0.08),
        ("post", [0.92, 0.92, 0.88, 1], 0.2, 0.0),
        ("bone", [0.91, 0.86, 0.74, 1], 0.25, 0.0),
        ("tube", [0.90, 0.91, 0.92, 1], 0.5, 0.0),
        ("accent", [0.93, 0.62, 0.10, 1], 0.4, 0.0),
        ("housing", [0.22, 0.24, 0.27, 1], 0.4, 0.0),
        ("active", [0.12, 0.32, 0.50, 1], 0.7, 0.1),
    ):
        spec.add_material(
            name=name, rgba=rgba, specular=specular, shininess=0.5, reflectance=reflectance
        )


def _room(spec: mujoco.MjSpec, cell: Cell) -> None:
    mujoco = mujoco_module()
    z = cell.floor_z_mm
    floor = spec.worldbody.add_body(name="floor")
    _box(floor, "floor", (0, 0, z - 50), (40_000, 40_000, 100), "floor")
    for pos, direction, diffuse, shadow in (
        ((-0.9, -1.6, 2.2), (0.35, 0.6, -1.0), 0.50, True),
        ((1.8, -1.2, 2.0), (-0.6, 0.5, -1.0), 0.28, False),
        ((0.0, 1.6, 2.4), (0.0, -0.4, -1.0), 0.18, False),
    ):
        spec.worldbody.add_light(
            pos=pos,
            dir=direction,
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            diffuse=[diffuse] * 3,
            specular=[0.15] * 3,
            ambient=[0, 0, 0],
            castshadow=shadow,
        )


def _specimen(
    spec: mujoco.MjSpec, cell: Cell, mesh: trimesh.Trimesh | None, world_from_specimen: Pose
) -> float | None:
    """Add the body; returns the height of its lowest point in the world, mm."""
    mujoco = mujoco_module()
    position, quat = world_from_specimen.to_metres()
    body = spec.worldbody.add_body(name="specimen", pos=position, quat=np.roll(quat, 1))
    if mesh is None or len(mesh.vertices) == 0:
        return None
    hull = mesh.convex_hull
    for name, part in (("specimen_hull", hull), ("specimen_look", mesh)):
        spec.add_mesh(
            name=name,
            uservert=(np.asarray(part.vertices, dtype=float) * MM).ravel(),
            userface=np.asarray(part.faces, dtype=np.int32).ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
    body.add_geom(
        name="specimen",
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname="specimen_hull",
        group=COLLISION_GROUP,
        material="bone",
    )
    body.add_geom(
        name="specimen_look",
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname="specimen_look",
        group=VISUAL_GROUP,
        contype=0,
        conaffinity=0,
        material="bone",
    )
    return float(world_from_specimen.apply(hull.vertices)[:, 2].min())


def _table(
    spec: mujoco.MjSpec, cell: Cell, world_from_specimen: Pose, bottom_mm: float | None
) -> None:
    table = cell.table
    if not table.present:
        return
    sx, sy, sz = table.size_mm
    top, floor = table.top_z_mm, cell.floor_z_mm
    if top - sz <= floor:
        raise ScenarioError(
            f"cell.table: its top plate, from {top - sz:g} to {top:g} mm, lies in the floor at "
            f"cell.floor_z_mm = {floor:g} mm"
        )
    x, y = world_from_specimen.position[:2]
    body = spec.worldbody.add_body(name="table")
    _box(body, "table_top", (x, y, top - sz / 2), (sx, sy, sz), "tabletop")
    column = (0.4 * sx, 0.35 * sy)
    _box(body, "table_column", (x, y, (top - sz + floor) / 2), (*column, top - sz - floor), "steel")
    _box(body, "table_foot", (x, y, floor + 25), (0.8 * sx, 0.7 * sy, 50), "pedestal")
    if bottom_mm is None:
        return
    if bottom_mm <= top:
        raise ScenarioError(
            f"cell.table.top_z_mm = {top:g} mm reaches into the specimen, whose lowest point is at "
            f"{bottom_mm:.1f} mm"
        )
    holder = spec.worldbody.add_body(name="holder")
    radius = table.holder_radius_mm
    _rod(holder, "holder_post", (x, y, top), (x, y, bottom_mm), radius, "post")
    foot = min(15.0, (bottom_mm - top) / 3)
    _rod(holder, "holder_rest", (x, y, bottom_mm - foot), (x, y, bottom_mm), 2 * radius, "post")
    _rod(holder, "holder_foot", (x, y, top), (x, y, top + foot), 2 * radius, "housing")


def _mount(spec: mujoco.MjSpec, cell: Cell, side: str, arm: Arm, loaded: ArmModel) -> None:
    """Stand the arm on a pedestal and give its flange a body for the tool."""
    position, quat = Pose.from_euler(arm.base_position_mm, arm.base_rotation_deg).to_metres()
    frame = spec.worldbody.add_frame(pos=position, quat=np.roll(quat, 1))
    spec.attach(loaded.spec, prefix=f"{side}_", frame=frame)
    x, y, z = arm.base_position_mm
    height = z - cell.floor_z_mm
    upright = np.allclose(np.asarray(arm.base_rotation_deg[:2]) % 360, 0)
    if height > 60 and upright:
        body = spec.worldbody.add_body(name=f"{side}_pedestal")
        _rod(body, f"{side}_pedestal", (x, y, z - height + 30), (x, y, z), 100, "pedestal")
        _box(body, f"{side}_footplate", (x, y, z - height + 15), (420, 420, 30), "pedestal")
    flange = spec.site(f"{side}_{loaded.flange_site}")
    link = flange.parent
    half = np.radians(arm.tool_rotation_deg) / 2
    turn = np.array([np.cos(half), 0, 0, np.sin(half)])
    mujoco = mujoco_module()
    mount_quat = np.zeros(4)
    mujoco.mju_mulQuat(mount_quat, np.asarray(flange.quat), turn)
    link.add_frame(name=f"{side}_flange_frame", pos=flange.pos, quat=mount_quat)
    link.add_body(name=f"{side}_tool_mount", pos=flange.pos, quat=mount_quat)


def _source_tool(body: Any, arm: Arm, panel: Panel) -> None:
    """A tube housing; the focal spot lies 20 mm behind its front, z leaves through the window."""
    s = arm.standoff_mm
    mass = arm.tool_mass_kg
    adapter = min(15.0, 0.1 * s)
    front = s + 20
    _rod(body, "source_adapter", (0, 0, 0), (0, 0, adapter), 50, "steel", mass=0.1 * mass)
    length = front - adapter - 8
    centre = (0, 0, adapter + length / 2)
    _box(body, "source_housing", centre, (96, 96, length), "tube", mass=0.85 * mass)
    _rod(body, "source_window", (0, 0, front - 8), (0, 0, front), 38, "accent", mass=0.05 * mass)
    body.add_site(name="source", pos=[0, 0, s * MM], group=4)


def _panel_tool(body: Any, arm: Arm, panel: Panel) -> None:
    """A flat panel on a bracket; the pixels' plane is 4 mm behind the cover."""
    s = arm.standoff_mm
    mass = arm.tool_mass_kg
    width, height = (edge + 2 * PANEL_BORDER_MM for edge in panel.size_mm)
    back = s + PANEL_COVER_MM - PANEL_DEPTH_MM
    if back < 20:
        raise ScenarioError(
            f"cell.detector_arm.standoff_mm = {s:g} mm leaves no room for the panel's housing: at "
            f"least {20 + PANEL_DEPTH_MM - PANEL_COVER_MM:g} mm are needed"
        )
    _rod(body, "detector_adapter", (0, 0, 0), (0, 0, 12), 50, "steel", mass=0.1 * mass)
    _rod(body, "detector_bracket", (0, 0, 12), (0, 0, back), 36, "tube", mass=0.1 * mass)
    plane = s + PANEL_COVER_MM - PANEL_DEPTH_MM / 2
    size = (width, height, PANEL_DEPTH_MM)
    _box(body, "detector_panel", (0, 0, plane), size, "housing", mass=0.8 * mass)
    active = (*panel.size_mm, 0.4)
    look = {"contype": 0, "conaffinity": 0, "mass": 0.0}
    _box(body, "detector_active", (0, 0, s + PANEL_COVER_MM), active, "active", **look)
    body.add_site(name="detector", pos=[0, 0, s * MM], group=4)


def _servos(spec: mujoco.MjSpec, arms: list[ArmModel], cell: Cell) -> tuple[str, ...]:
    """One torque-limited position servo a joint; its gains follow once inertias are known."""
    mujoco = mujoco_module()
    names = []
    for side, arm, section in zip(ARMS, arms, (cell.source_arm, cell.detector_arm), strict=True):
        limits = arm.torque_limits * section.torque_scale
        for joint_name, limit in zip(arm.joint_names, limits, strict=True):
            name = f"{side}_{joint_name}"
            joint = spec.joint(name)
            joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_TRUE
            joint.actfrcrange = [-limit, limit]
            # Gravity compensation is the motor's work too: it counts within the limit.
            joint.actgravcomp = True
            actuator = spec.add_actuator(name=name, target=name)
            actuator.trntype = mujoco.mjtTrn.mjTRN_JOINT
            actuator.gaintype = mujoco.mjtGain.mjGAIN_FIXED
            actuator.biastype = mujoco.mjtBias.mjBIAS_AFFINE
            actuator.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
            actuator.forcerange = [-limit, limit]
            names.append(name)
    for body in spec.bodies:
        if body.name and body.name.startswith(ARMS):
            body.gravcomp = 1.0
    return tuple(names)


def _exclude_adjacent(spec: mujoco.MjSpec) -> None:
    """Bodies joined to each other may touch; MuJoCo itself filters only moving parents."""
    listed = {frozenset((e.bodyname1, e.bodyname2)) for e in spec.excludes}
    bodies = [body for body in spec.bodies if body.name != "world"]
    for link in bodies:
        if not link.joints:
            continue
        carrier = link.parent
        carriers = {carrier.name}
        if _link_of(carrier).joints:  # not part of the building: all of that link is adjacent
            carriers = {b.name for b in bodies if _link_of(b).name == _link_of(carrier).name}
        for body in bodies:
            if _link_of(body).name != link.name:
                continue
            for name in sorted(carriers):
                if frozenset((body.name, name)) not in listed:
                    spec.add_exclude(bodyname1=body.name, bodyname2=name)


def _link_of(body: Any) -> Any:
    """The body that carries the joint: bodies without one are a piece of their parent."""
    while not body.joints and body.parent is not None and body.parent.name != "world":
        body = body.parent
    return body


def _compiled(
    spec: mujoco.MjSpec, cell: Cell, panel: Panel, arms: list[ArmModel], names: tuple[str, ...]
) -> CellModel:
    model = spec.compile()
    if tuple(model.joint(i).name for i in range(model.njnt)) != names:
        raise AssertionError("joints are not in the order source arm, detector arm")
    first = len(arms[0].joint_names)
    scales = np.repeat(
        [cell.source_arm.speed_scale, cell.detector_arm.speed_scale],
        [first, len(arms[1].joint_names)],
    )
    _tune_servos(model)
    return CellModel(
        model=model,
        cell=cell,
        panel=panel,
        joint_names=names,
        arm_joints=(slice(0, first), slice(first, len(names))),
        site_ids=(model.site("source").id, model.site("detector").id),
        specimen_body=model.body("specimen").id,
        torque_limits=model.jnt_actfrcrange[:, 1].copy(),
        speed_limits=np.concatenate([arm.speed_limits for arm in arms]),
        speed_scales=scales,
        pairs=_non_adjacent_pairs(model),
        lever=_levers(model),
    )


def _tune_servos(model: mujoco.MjModel) -> None:
    """Critically damped gains from the largest inertia a joint meets in a spread of poses."""
    mujoco = mujoco_module()
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    inertia = np.zeros(model.nv)
    full = np.zeros((model.nv, model.nv))
    low, high = np.maximum(model.jnt_range.T[0], -np.pi), np.minimum(model.jnt_range.T[1], np.pi)
    for _ in range(64):
        data.qpos[:] = rng.uniform(low, high)
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, full)
        inertia = np.maximum(inertia, np.diag(full))
    stiffness = BANDWIDTH_RAD_S**2 * inertia
    model.actuator_gainprm[:, 0] = stiffness
    model.actuator_biasprm[:, 1] = -stiffness
    model.actuator_biasprm[:, 2] = -2 * BANDWIDTH_RAD_S * inertia


def _non_adjacent_pairs(model: mujoco.MjModel) -> np.ndarray:
    """Solid geoms of bodies that can move against each other and are not excluded."""
    excluded = {(int(s) >> 16, int(s) & 0xFFFF) for s in model.exclude_signature}
    solid = [g for g in range(model.ngeom) if model.geom_contype[g] or model.geom_conaffinity[g]]
    pairs = []
    for k, a in enumerate(solid):
        for b in solid[k + 1 :]:
            first, second = int(model.geom_bodyid[a]), int(model.geom_bodyid[b])
            same_piece = model.body_weldid[first] == model.body_weldid[second]
            joined = (first, second) in excluded or (second, first) in excluded
            if not same_piece and not joined:
                pairs.append((a, b))
    return np.array(pairs, dtype=np.int32).reshape(-1, 2)


def _levers(model: mujoco.MjModel) -> Floats:
    """Lengths of the chain from each joint to each body, with the body's own size."""
    size = np.zeros(model.nbody)
    for geom in range(model.ngeom):
        body = model.geom_bodyid[geom]
        extent = model.geom_rbound[geom] + np.linalg.norm(model.geom_pos[geom])
        size[body] = max(size[body], float(extent))
    lever = np.zeros((model.nbody, model.njnt))
    for body in range(model.nbody):
        length, link = size[body], body
        while link != 0:
            for j in range(
                model.body_jntadr[link], model.body_jntadr[link] + model.body_jntnum[link]
            ):
                lever[body, j] = length + float(np.linalg.norm(model.jnt_pos[j]))
            length += float(np.linalg.norm(model.body_pos[link]))
            link = int(model.body_parentid[link])
    return lever
