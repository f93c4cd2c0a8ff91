"""Construction of the cell as one MuJoCo model from a scenario's ``cell`` section."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np

from twinct.core.errors import MemoryShortageError, ScenarioError
from twinct.core.files.boundary import require_memory
from twinct.core.progress import spend
from twinct.geometry import Floats, Panel, Pose
from twinct.robots.cell._mujoco import mujoco_module
from twinct.robots.cell.arms import ArmModel, load_arm
from twinct.robots.cell.c_arm_bodies import add_c_arm
from twinct.robots.cell.collision_pairs import (
    exclude_adjacent,
    levers,
    near_pairs,
    non_adjacent_pairs,
)
from twinct.robots.cell.rails import add_rail, add_turntable, on_rail, on_turntable
from twinct.robots.cell.solids import (
    COLLISION_GROUP,
    LOOK_ONLY,
    MM,
    VISUAL_GROUP,
    add_box,
    add_mesh,
    add_rod,
)
from twinct.robots.cell.standing import OBJECT, add_objects, add_zones, object_margins
from twinct.robots.cell.structural_pairs import without_structural
from twinct.robots.cell.tools import add_tool, flange_from_tip
from twinct.robots.sections import Arm, Cell, DetectorArm, GantryCell, SourceArm

if TYPE_CHECKING:
    import mujoco
    import trimesh

ARMS = ("source", "detector")
"""Prefixes of the two arms, in the order of joints, actuators and all stacked arrays."""

TOOLS_MM = 200.0
"""Length that the housings of source and panel add to the extent of a gantry's picture."""

RAIL_MM = 120.0
"""Depth of a rail or turntable below the base of an arm without a pillar."""

LYING_MM = 30.0
"""Gap above the mattress of an operating room below which a specimen lies on it."""

OVERLAP_MM = 0.01
"""Overlap up to which two bodies merely touch."""

OPERATING_LIGHTS = ((-0.30, 0.42, -1.0), (-0.8, 0.3, -0.5), (0.2, 0.9, -0.6))
"""Directions of the lights between the walls of an operating room."""

LARGEST_PICTURE = (3840, 2400)
"""Width and height in pixels for which MuJoCo allocates memory."""


@dataclass(frozen=True, eq=False)
class CellModel:
    """Compiled model of the cell, with the indices and limits of its parts.

    Every joint is a hinge, except that of a rail, the first one of its arm: its unit is m, not rad.
    Joints, actuators and all arrays are in the order source arm, then detector arm, from base to
    flange.

    Attributes:
        model: MuJoCo's model, metres.
        cell: section from which the model was built.
        panel: pixel lattice around which the housing was built.
        joint_names: prefixed ``source_`` and ``detector_``.
        arm_joints: slice of the joints of each arm.
        site_ids: sites ``source`` and ``detector``, with the frames of the design.
        specimen_body: body id of ``specimen``.
        torque_limits: usable torques (published limit times ``torque_scale``), N m, (n,).
        speed_limits: published joint speeds, rad/s, (n,).
        speed_scales: shares of the published speeds that a move may use, (n,).
        pairs: geom ids of all pairs of non-adjacent bodies that can move against each other,
            (p, 2).
        bandwidths: natural frequencies of the servos, rad/s, (n,).
        feedforward: shares of the planned torque and speed that are fed forward, (n,).
        homes: start of the path search for each arm, rad, or None if the scenario states none.
        margins: additional gap that arms keep from each geom, m, (geoms,), by its object's group.
        lever: bound on the distance of any point of a body from a joint's axis, m, (bodies, n), 1
            for a rail; zero if the joint does not move the body.
        notes: data of the arms that the scenario supplied in place of a file, in words.
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
    bandwidths: Floats
    feedforward: Floats
    homes: tuple[Floats | None, ...]
    margins: Floats
    lever: Floats
    notes: tuple[str, ...] = ()

    @property
    def joint_ranges(self) -> Floats:
        """Lowest and highest position of each joint, rad, (n, 2)."""
        return self.model.jnt_range.copy()

    def body_of_geom(self, geom: int) -> str:
        """Return the name of the body of a geom."""
        return self.model.body(self.model.geom_bodyid[geom]).name


@dataclass(frozen=True, eq=False)
class GantryModel:
    """Compiled cell without arms, in which nothing moves; it extends from source to panel.

    Attributes:
        model: MuJoCo's model, metres.
    """

    model: mujoco.MjModel


def build_cell(
    cell: Cell,
    specimen_mesh: trimesh.Trimesh | None,
    world_from_specimen: Pose,
    panel: Panel,
    *,
    solids: Sequence[trimesh.Trimesh] = (),
) -> CellModel:
    """Compose and compile the cell; ``apart`` judges its fixed bodies.

    Args:
        cell: arms, table, floor.
        specimen_mesh: surface in the specimen's frame, mm. None leaves the holder empty.
        world_from_specimen: pose of the specimen.
        panel: pixel lattice, which determines the size of the housing.
        solids: convex bodies in the specimen's frame, mm, that collide in its place; its convex
            hull by default.

    Raises:
        MissingExtraError: MuJoCo, or a requested Menagerie, is not installed.
        ScenarioError: an arm or a dimension cannot be built.
    """
    spec = _room(cell.floor_z_mm, cell.room)
    spec.option.timestep = cell.timestep_ms / 1000
    bottom_mm = _specimen(spec, specimen_mesh, world_from_specimen, solids)
    _table(spec, cell, world_from_specimen, bottom_mm)
    arms = []
    for side, arm in zip(ARMS, (cell.source_arm, cell.detector_arm), strict=True):
        loaded = load_arm(arm, f"cell.{side}_arm")
        if arm.rail is not None:
            loaded = on_rail(loaded, arm.rail)
        if arm.turntable is not None:
            loaded = on_turntable(loaded, arm.turntable)
        body = _mount(spec, cell, side, arm, loaded).add_body(name=side)
        held = arm.tool, arm.standoff_mm, arm.tool_mass_kg
        add_tool(spec, body, side, *held, panel, f"cell.{side}_arm")
        arms.append(loaded)
    add_zones(spec, cell.zones)
    add_objects(spec, cell.keyed_objects)
    names = _servos(spec, arms, cell)
    exclude_adjacent(spec, _described_tools(cell))
    # Per joint: position, velocity and acceleration of the servos' reference; then the mark of the
    # plan from which the reference comes.
    spec.nuserdata = 3 * len(names) + 1
    built = _compiled(spec, cell, panel, arms, names)
    of_pair, of_vertex = BUILD_UNITS
    spend(of_pair * built.model.ngeom**2 + of_vertex * sum(len(s.vertices) for s in solids))
    return built


def build_gantry(
    cell: GantryCell,
    specimen_mesh: trimesh.Trimesh | None,
    world_from_specimen: Pose,
    panel: Panel,
    world_from_source: Pose,
    world_from_detector: Pose,
    *,
    solids: Sequence[trimesh.Trimesh] = (),
) -> GantryModel:
    """Build the cell of a gantry at one view: source and panel float in the air, or on a C-arm.

    Args:
        cell: section of the gantry, with the height of the floor.
        specimen_mesh: surface in the specimen's frame, mm; None: there is no specimen.
        world_from_specimen: pose of the specimen.
        panel: pixel lattice, which determines the size of the housing.
        world_from_source: pose of the source.
        world_from_detector: pose of the panel.
        solids: convex bodies in the specimen's frame, mm, that collide in its place; its convex
            hull by default.

    Raises:
        MissingExtraError: MuJoCo is not installed.
        ScenarioError: a tool cannot be built.
        SpecimenError: the mesh file of an object or a tool is unusable.
    """
    spec, behind = _room(cell.floor_z_mm), list[float]()
    _specimen(spec, specimen_mesh, world_from_specimen, solids)
    add_objects(spec, cell.keyed_objects)
    for side, arm, tool, pose in (
        ("source", SourceArm(), cell.source_tool, world_from_source),
        ("detector", DetectorArm(), cell.detector_tool, world_from_detector),
    ):
        standoff = arm.standoff_mm if tool is None else tool.tip_mm[2]
        behind.append(standoff)
        position, quat = (pose @ flange_from_tip(tool, standoff).inverse()).to_metres()
        body = spec.worldbody.add_body(name=side, pos=position, quat=np.roll(quat, 1))
        key = f"cell.{side}_tool" if tool else "cell"
        add_tool(spec, body, side, tool, standoff, arm.tool_mass_kg, panel, key)
    if cell.c_arm is not None:
        views = world_from_source, world_from_detector
        add_c_arm(spec, cell.c_arm, views, (behind[0], behind[1]), cell.floor_z_mm)
    spec.stat.center = (world_from_source.position + world_from_detector.position) / 2 * MM
    spec.stat.extent = (world_from_source.distance_mm(world_from_detector) + TOOLS_MM) * MM
    if cell.c_arm is not None:
        spec.stat.center = np.array(cell.c_arm.isocentre_mm) * MM
        spec.stat.extent = 2.4 * (cell.c_arm.radius_mm + cell.c_arm.profile_mm[0]) * MM
    return GantryModel(_compile(spec))


def _room(floor_z_mm: float, room: str = "plain") -> mujoco.MjSpec:
    """Return a model with floor, lights and all materials."""
    xml = files("twinct.robots.cell").joinpath("room.xml").read_text(encoding="utf-8")
    spec = mujoco_module().MjSpec.from_string(xml)
    spec.visual.global_.offwidth, spec.visual.global_.offheight = LARGEST_PICTURE
    floor = spec.worldbody.add_body(name="floor")
    material = "floor"
    if room == "operating":  # its walls need light from the camera's side
        material = "vinyl"
        for light, towards in zip(spec.lights, OPERATING_LIGHTS, strict=True):
            light.dir = towards
    add_box(floor, "floor", (0, 0, floor_z_mm - 50), (40_000, 40_000, 100), material)
    return spec


def _specimen(
    spec: mujoco.MjSpec,
    mesh: trimesh.Trimesh | None,
    world_from_specimen: Pose,
    solids: Sequence[trimesh.Trimesh] = (),
) -> float | None:
    """Add the specimen, and return the height of its lowest point in the world, mm."""
    position, quat = world_from_specimen.to_metres()
    body = spec.worldbody.add_body(name="specimen", pos=position, quat=np.roll(quat, 1))
    if mesh is None or len(mesh.vertices) == 0:
        return None
    mesh_geom = {"type": mujoco_module().mjtGeom.mjGEOM_MESH, "material": "specimen"}
    hulls = solids or (mesh.convex_hull,)
    for index, hull in enumerate(hulls):
        name = f"specimen_{index}" if index else "specimen"
        add_mesh(spec, f"{name}_hull", hull)
        body.add_geom(name=name, meshname=f"{name}_hull", group=COLLISION_GROUP, **mesh_geom)
    add_mesh(spec, "specimen_look", mesh)
    look = {"group": VISUAL_GROUP, **LOOK_ONLY}
    body.add_geom(name="specimen_look", meshname="specimen_look", **look, **mesh_geom)
    return min(float(world_from_specimen.apply(hull.vertices)[:, 2].min()) for hull in hulls)


def _table(
    spec: mujoco.MjSpec, cell: Cell, world_from_specimen: Pose, bottom_mm: float | None
) -> None:
    table = cell.table
    if not table.present:
        return
    top = table.top_z_mm
    x, y = world_from_specimen.position[:2]
    middle = cell.table_middle_mm((x, y))
    if cell.room == "plain":
        _plain_table(spec, cell, *middle)
    elif bottom_mm is not None and bottom_mm < top + LYING_MM:
        return  # it lies on the mattress; ``apart`` judges whether it reaches into it
    beside = np.abs(np.subtract((x, y), middle)) > np.divide(table.size_mm[:2], 2)
    if bottom_mm is None or beside.any():
        return
    if bottom_mm <= top:
        raise ScenarioError(
            f"cell.table.top_z_mm = {top:g} mm reaches into the specimen, whose lowest point is at "
            f"{bottom_mm:.1f} mm"
        )
    holder = spec.worldbody.add_body(name="holder")
    radius = table.holder_radius_mm
    add_rod(holder, "holder_post", (x, y, top), (x, y, bottom_mm), radius, "post")
    foot = min(15.0, (bottom_mm - top) / 3)
    add_rod(holder, "holder_rest", (x, y, bottom_mm - foot), (x, y, bottom_mm), 2 * radius, "post")
    add_rod(holder, "holder_foot", (x, y, top), (x, y, top + foot), 2 * radius, "housing")


def _plain_table(spec: mujoco.MjSpec, cell: Cell, x: float, y: float) -> None:
    """Add a top plate, its column and its foot about a vertical line."""
    sx, sy, sz = cell.table.size_mm
    top, floor = cell.table.top_z_mm, cell.floor_z_mm
    if top - sz <= floor:
        raise ScenarioError(
            f"cell.table: its top plate, from {top - sz:g} to {top:g} mm, lies in the floor at "
            f"cell.floor_z_mm = {floor:g} mm"
        )
    body = spec.worldbody.add_body(name="table")
    add_box(body, "table_top", (x, y, top - sz / 2), (sx, sy, sz), "tabletop")
    column = (0.4 * sx, 0.35 * sy)
    add_box(
        body, "table_column", (x, y, (top - sz + floor) / 2), (*column, top - sz - floor), "steel"
    )
    add_box(body, "table_foot", (x, y, floor + 25), (0.8 * sx, 0.7 * sy, 50), "pedestal")


def _mount(spec: mujoco.MjSpec, cell: Cell, side: str, arm: Arm, loaded: ArmModel) -> Any:
    """Mount an arm on its pedestal, and return a new body at its flange for the tool."""
    world_from_file = Pose.from_euler(arm.base_position_mm, arm.base_rotation_deg)
    if loaded.file_from_base is not None:
        world_from_file @= loaded.file_from_base.inverse()
    position, quat = world_from_file.to_metres()
    x, y, z = arm.base_position_mm
    height = z - cell.floor_z_mm
    upright = np.allclose(np.asarray(arm.base_rotation_deg[:2]) % 360, 0)
    carrier, depth = spec.worldbody, height if upright and height > RAIL_MM else RAIL_MM
    if arm.rail is not None:
        carrier = add_rail(spec, side, arm, arm.rail, depth)
    elif arm.turntable is not None:
        carrier = add_turntable(spec, side, arm, arm.turntable, depth)
    fixed = carrier is spec.worldbody
    if not fixed:
        position = position - carrier.pos
    frame = carrier.add_frame(pos=position, quat=np.roll(quat, 1))
    spec.attach(loaded.spec, prefix=f"{side}_", frame=frame)
    if fixed and height > 60 and upright:
        body = spec.worldbody.add_body(name=f"{side}_pedestal")
        add_rod(body, f"{side}_pedestal", (x, y, z - height + 30), (x, y, z), 100, "pedestal")
        add_box(body, f"{side}_footplate", (x, y, z - height + 15), (420, 420, 30), "pedestal")
    flange = spec.site(f"{side}_{loaded.flange_site}")
    half = np.radians(arm.tool_rotation_deg) / 2
    turn = np.array([np.cos(half), 0, 0, np.sin(half)])
    mount_quat = np.zeros(4)
    mujoco_module().mju_mulQuat(mount_quat, np.asarray(flange.quat), turn)
    flange.parent.add_frame(name=f"{side}_flange_frame", pos=flange.pos, quat=mount_quat)
    return flange.parent.add_body(name=f"{side}_tool_mount", pos=flange.pos, quat=mount_quat)


def _servos(spec: mujoco.MjSpec, arms: list[ArmModel], cell: Cell) -> tuple[str, ...]:
    """Add a torque-limited position servo per joint; gains are set once inertias are known."""
    mujoco = mujoco_module()
    names = []
    for side, arm, section in zip(ARMS, arms, (cell.source_arm, cell.detector_arm), strict=True):
        limits = arm.torque_limits * section.torque_scale
        for joint_name, limit in zip(arm.joint_names, limits, strict=True):
            name = f"{side}_{joint_name}"
            joint = spec.joint(name)
            joint.actfrclimited = mujoco.mjtLimited.mjLIMITED_TRUE
            joint.actfrcrange = [-limit, limit]
            # The motor also provides gravity compensation, which counts towards its limit.
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


_KEYS = {
    "source": "cell.source_arm",
    "detector": "cell.detector_arm",
    "specimen": "specimen.parts",
    "table": "cell.table",
    "holder": "cell.table",
    "zone": "cell.zones",
    "object": "cell.objects",
}
"""Scenario key for each part of the model, by the prefix of its name."""


BUILD_UNITS = 0.12, 0.25
"""Work of building a cell, for each pair of geoms and each vertex of the specimen."""

COMPILE_BYTES = 192 * 2**20
"""Memory that the compiler of models may take: 136 MiB for two arms. Without it, it may crash."""


def _compile(spec: mujoco.MjSpec) -> mujoco.MjModel:
    require_memory("the model of the room", COMPILE_BYTES, MemoryShortageError)
    try:
        return spec.compile()
    except (ValueError, mujoco_module().FatalError) as error:
        reason = " ".join(str(error).split()).removeprefix("Error: ")
        named = re.search(r"name '([a-z]+)", reason)
        key = _KEYS.get(named[1], "cell") if named else "cell"
        raise ScenarioError(f"{key}: MuJoCo cannot build this: {reason}") from None


def _described_tools(cell: Cell) -> list[str]:
    """Return the bodies of the tools that the scenario describes."""
    arms = zip(ARMS, (cell.source_arm, cell.detector_arm), strict=True)
    return [side for side, arm in arms if arm.tool is not None]


def _compiled(
    spec: mujoco.MjSpec, cell: Cell, panel: Panel, arms: list[ArmModel], names: tuple[str, ...]
) -> CellModel:
    model = _compile(spec)
    if tuple(model.joint(i).name for i in range(model.njnt)) != names:
        raise AssertionError("joints are not in the order source arm, detector arm")
    counts = [len(arm.joint_names) for arm in arms]
    servos = cell.source_arm.servo, cell.detector_arm.servo
    bandwidths = np.repeat([servo.bandwidth_rad_s for servo in servos], counts)
    _tune_servos(model, bandwidths)
    lever, margins = levers(model), object_margins(model, cell)
    pairs = without_structural(model, non_adjacent_pairs(model), _described_tools(cell))
    return CellModel(
        model=model,
        cell=cell,
        panel=panel,
        joint_names=names,
        arm_joints=(slice(0, counts[0]), slice(counts[0], len(names))),
        site_ids=(model.site("source").id, model.site("detector").id),
        specimen_body=model.body("specimen").id,
        torque_limits=model.jnt_actfrcrange[:, 1].copy(),
        speed_limits=np.concatenate([arm.speed_limits for arm in arms]),
        speed_scales=np.repeat(
            [cell.source_arm.speed_scale, cell.detector_arm.speed_scale], counts
        ),
        pairs=near_pairs(model, pairs, lever, margins, OBJECT),
        bandwidths=bandwidths,
        feedforward=np.repeat([servo.feedforward for servo in servos], counts),
        homes=tuple(arm.home for arm in arms),
        margins=margins,
        lever=lever,
        notes=tuple(
            f"{side} arm: {note}"
            for side, arm in zip(ARMS, arms, strict=True)
            for note in arm.notes
        ),
    )


def _tune_servos(model: mujoco.MjModel, bandwidths: Floats) -> None:
    """Set critically damped gains for the largest inertia of each joint over random poses."""
    mujoco = mujoco_module()
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    inertia = np.zeros(model.nv)
    full = np.zeros((model.nv, model.nv))
    # Only what the inertia needs: a search builds hundreds of cells.
    steps = (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_makeM)
    low, high = np.maximum(model.jnt_range.T[0], -np.pi), np.minimum(model.jnt_range.T[1], np.pi)
    for _ in range(64):
        data.qpos[:] = rng.uniform(low, high)
        for step in steps:
            step(model, data)
        mujoco.mj_fullM(model, data, full)
        inertia = np.maximum(inertia, np.diag(full))
    stiffness = bandwidths**2 * inertia
    model.actuator_gainprm[:, 0] = stiffness
    model.actuator_biasprm[:, 1] = -stiffness
    model.actuator_biasprm[:, 2] = -2 * bandwidths * inertia
