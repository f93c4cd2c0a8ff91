"""The operating room: arms or a gantry, table, floor."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, cast

from pydantic import Discriminator, Field, Tag, field_validator, model_validator

from twinct.core.extensions import Registry
from twinct.core.foreign_text import quoted
from twinct.core.settings import (
    Conflict,
    ConflictError,
    Coordinate,
    FileOf,
    Finite,
    Length,
    Lengths,
    Positive,
    ReadBy,
    Section,
    Vector,
    facts,
    setting,
)
from twinct.robots.arm_files import BUILT_IN, ArmFile
from twinct.robots.sections.c_arm import CArm
from twinct.robots.sections.operating_room import operating_room, plate_middle_mm
from twinct.robots.sections.tool import Tool
from twinct.specimen.sections.room_objects import (
    LEAST_HEIGHT_MM,
    GroupClearance,
    RoomObject,
    Zone,
    keyed,
    require_unique_names,
)


@cache
def known_arms() -> Registry[ArmFile]:
    """Return all arms by name; they are looked up once per process."""
    return Registry("twinct.arms", ArmFile, BUILT_IN)


def _offered_file(model: str | None) -> Path | None:
    """Return the file of an arm of another package."""
    offered = None if model is None or model in BUILT_IN else known_arms().get(model)
    return offered and offered.file


def _models_in_words(names: Iterable[str]) -> str:
    return f"Model of the arm: {', '.join(names)}, or menagerie:NAME."


def _with_all_models(schema: dict[str, Any]) -> None:
    """Add the arms of other packages to the key's schema."""
    arms = known_arms()
    if "description" in schema:
        schema["description"] = _models_in_words(arms)
    schema |= facts(source="manufacturers' data sheets: docs/arms.md")
    schema["pattern"] = rf"^({'|'.join(map(re.escape, arms))}|menagerie:[A-Za-z0-9_]+)$"


_OF_FILE = ("base", "flange", "ignore_pairs", "link_density_kg_m3", "joint_torque_nm")
"""Keys that only an arm from a file has."""


LONGEST_RAIL_MM = 3000.0
"""Largest distance of the base from ``base_position_mm``."""


class Rail(Section):
    """A linear rail that carries the arm's base: on the floor, on a wall, or under the ceiling."""

    range_mm: tuple[Coordinate, Coordinate] = Field(
        description="Limits of the base's travel along the axis, from base_position_mm; at most "
        f"{LONGEST_RAIL_MM:g} mm in either direction."
    )
    axis: Vector = setting((0.0, 1.0, 0.0), "Direction of the rail in the world.", unit="1")
    speed_mm_s: Positive = setting(500.0, "Largest speed; speed_scale applies to it, too.")
    force_n: Positive = setting(
        2000.0,
        "Largest force of the drive, which limits the acceleration; torque_scale applies to it.",
        unit="N",
    )
    carriage_mass_kg: Positive = setting(60.0, "Mass of carriage and pillar.")

    @model_validator(mode="after")
    def _limits_and_direction(self) -> Rail:
        low, high = self.range_mm
        if not -LONGEST_RAIL_MM <= low < high <= LONGEST_RAIL_MM:
            what = (
                f"range_mm must rise from one limit to the other, within -{LONGEST_RAIL_MM:g} and "
                f"{LONGEST_RAIL_MM:g} mm, but is [{low:g}, {high:g}]"
            )
            raise ConflictError(Conflict(what, ("range_mm",)))
        if not any(self.axis):
            raise ConflictError(Conflict("axis must have a length", ("axis",)))
        return self


class Turntable(Section):
    """A turntable that carries the arm's base: on the floor, on a wall, or under the ceiling."""

    range_deg: tuple[Finite, Finite] = Field(
        description="Limits of the turn, within -360 and 360 deg; at 0 the base is at "
        "base_position_mm.",
        json_schema_extra=facts(unit="deg"),
    )
    centre_mm: Vector = setting(
        (0.0, 0.0, 0.0), "Point on the axis, relative to base_position_mm, along the world's axes."
    )
    axis: Vector = setting((0.0, 0.0, 1.0), "Direction of the axis in the world.", unit="1")
    speed_deg_s: Positive = setting(40.0, "Largest speed; speed_scale applies to it, too.")
    torque_nm: Positive = setting(
        2000.0,
        "Largest torque of the drive, which limits the acceleration; torque_scale applies to it.",
        unit="N m",
    )
    mass_kg: Positive = setting(80.0, "Mass of the part that turns, pillar included.")

    @model_validator(mode="after")
    def _limits_and_direction(self) -> Turntable:
        low, high = self.range_deg
        if not -360 <= low < high <= 360:
            what = (
                "range_deg must rise from one limit to the other, within -360 and 360 deg, but is "
                f"[{low:g}, {high:g}]"
            )
            raise ConflictError(Conflict(what, ("range_deg",)))
        if not any(self.axis):
            raise ConflictError(Conflict("axis must have a length", ("axis",)))
        return self


class Servo(Section):
    """Servos of the joints, as the encoders see them."""

    bandwidth_rad_s: float = setting(
        80.0,
        "Natural frequency of the critically damped servos; the default settles a 1 mm step in "
        "0.1 s.",
        unit="rad/s",
        ge=1,
        le=400,
    )
    feedforward: float = setting(
        1.0,
        "Share of the planned torque and speed that is fed forward. At 0, a joint lags by 2 / "
        "bandwidth_rad_s behind the plan.",
        ge=0,
        le=1,
    )


class Arm(Section):
    """One arm and its tool."""

    model: Annotated[str | None, ReadBy("plan"), FileOf(_offered_file)] = Field(
        default="ur10e",
        description=_models_in_words(BUILT_IN),
        json_schema_extra=_with_all_models,
    )
    file: Annotated[Path | None, ReadBy("plan")] = Field(
        default=None,
        description="Instead of model: MJCF or URDF file of your own arm, see docs/arm_files.md. "
        "Its includes and meshes lie in its folder or below; those of a URDF may also lie in ROS "
        "packages.",
    )
    base: Annotated[str | None, ReadBy("plan")] = Field(
        default=None,
        description="With file: the body or link whose frame is the arm's base; null: the first "
        "one.",
    )
    flange: Annotated[str | None, ReadBy("plan")] = Field(
        default=None,
        description="With file: the site, body or link at the tool flange, z pointing away from "
        "the arm; null: one of the usual names.",
    )
    ignore_pairs: Annotated[tuple[tuple[str, str], ...], ReadBy("plan")] = Field(
        default=(),
        description="With file: pairs of bodies or links of the arm that are not checked against "
        "each other, such as those that its maker's SRDF disables.",
    )
    rail: Annotated[Rail | None, ReadBy("plan")] = Field(
        default=None,
        description="Linear rail that carries the base: one more joint, which plans use.",
    )
    turntable: Annotated[Turntable | None, ReadBy("plan")] = Field(
        default=None,
        description="Turntable that carries the base, instead of a rail.",
    )
    home: Annotated[tuple[Finite, ...] | None, ReadBy("plan")] = Field(
        default=None,
        description="Joint positions from base to flange, at which the search for a path starts.",
        json_schema_extra=facts(unit="deg"),
    )
    base_position_mm: Annotated[Vector, ReadBy("plan")] = Field(
        description="Origin of the arm's base in the world."
    )
    base_rotation_deg: Vector = setting(
        (0.0, 0.0, 0.0), "Extrinsic rotations of the base about x, y, z.", read_by="plan"
    )
    standoff_mm: Length = setting(
        100.0,
        "Distance from flange to focal spot, or to panel centre, along the flange axis.",
        read_by="plan",
    )
    tool_rotation_deg: Finite = setting(
        0.0, "Rotation about the flange axis at which the tool is mounted.", read_by="plan"
    )
    tool: Annotated[Tool | None, ReadBy("plan")] = Field(
        default=None,
        description="Shapes of tube or panel, such as a mesh, with the place of focal spot or "
        "active area. standoff_mm is then tip_mm's z unless it is set, and may only be larger, for "
        "a spacer. null: a housing of usual size.",
    )
    tool_mass_kg: Annotated[Positive, ReadBy("executed")] = Field(description="Mass of the tool.")
    servo: Servo = setting(Servo(), "Servos of the joints.", read_by="executed")
    torque_scale: float = setting(
        1.0,
        "Share of the published torque limits that may be used.",
        gt=0,
        le=1,
        source="limits: manufacturer",
        read_by="executed",
    )
    speed_scale: float = setting(
        0.5,
        "Share of the published joint speeds that a move may use.",
        gt=0,
        le=1,
        source="limits: manufacturer",
        read_by="executed",
    )
    joint_speed_deg_s: Positive = setting(
        90.0,
        "Speed limit of every joint if the model states none, as in Menagerie and MJCF. With "
        "file, set this key even if it is 90.",
        read_by="executed",
    )

    link_density_kg_m3: Annotated[Positive | None, ReadBy("executed")] = Field(
        default=None,
        description="With file: density of links whose inertia the file does not state; they get "
        "that of their collision shapes. null: such a file is refused.",
        json_schema_extra=facts(unit="kg/m^3"),
    )
    joint_torque_nm: Annotated[Positive | tuple[Positive, ...] | None, ReadBy("executed")] = Field(
        default=None,
        description="With file: torque limits of joints whose limit the file does not state, one "
        "number for each joint from base to flange, or one for all. null: such a file is refused.",
        json_schema_extra=facts(unit="N m"),
    )

    @field_validator("model")
    @classmethod
    def _known_model(cls, model: str | None) -> str | None:
        if model is None:
            return None
        menagerie, colon, name = model.partition(":")
        arms = known_arms()
        if model in arms or (menagerie == "menagerie" and re.fullmatch(r"\w+", name)):
            return model
        if model in arms.broken:
            raise ValueError(arms.broken[model])
        near = difflib.get_close_matches(model, arms, n=1)
        hint = f"; did you mean {near[0]!r}?" if near and not colon else ""
        raise ValueError(
            f"unknown arm {quoted(model)}{hint} (known: {', '.join(arms)}, and menagerie:NAME "
            "for an "
            "arm of MuJoCo Menagerie)"
        )

    @model_validator(mode="after")
    def _one_arm(self) -> Arm:
        if self.file is not None and "model" not in self.model_fields_set:
            object.__setattr__(self, "model", None)  # the file replaces the default model
        if (self.model is None) == (self.file is None):
            both = "exclude each other: with file, leave out model or set it to null"
            what = f"model and file {both if self.file else 'are both null: give one'}"
            raise ConflictError(Conflict(what, ("model", "file")))
        lone = [name for name in _OF_FILE if getattr(self, name) and not self.file]
        if lone:
            raise ConflictError(
                Conflict(f"{' and '.join(lone)}: only allowed with file", tuple(lone))
            )
        if self.rail is not None and self.turntable is not None:
            what = "rail and turntable exclude each other: one of them carries the base"
            raise ConflictError(Conflict(what, ("rail", "turntable")))
        return self

    @model_validator(mode="after")
    def _tool_is_described(self) -> Arm:
        if self.tool is None:
            return self
        if "tool_mass_kg" not in self.model_fields_set:
            what = "tool: its mass decides on torques: set tool_mass_kg, too"
            raise ConflictError(Conflict(what, ("tool", "tool_mass_kg")))
        if "standoff_mm" not in self.model_fields_set:
            object.__setattr__(self, "standoff_mm", self.tool.tip_mm[2])
        return self

    @property
    def label(self) -> str:
        """Name of the arm in reports."""
        return self.model or Path(self.file or "").name


class SourceArm(Arm):
    """The arm with the X-ray source."""

    base_position_mm: Vector = setting(
        (750.0, 0.0, -150.0),
        "Origin of the arm's base in the world.",
        source="docs/reach.md",
        read_by="plan",
    )
    base_rotation_deg: Vector = setting(
        (0.0, 0.0, 180.0), "Extrinsic rotations of the base about x, y, z.", read_by="plan"
    )
    tool_mass_kg: Positive = setting(8.0, "Mass of the X-ray source.", read_by="executed")


class DetectorArm(Arm):
    """The arm with the panel."""

    base_position_mm: Vector = setting(
        (-750.0, 0.0, -150.0),
        "Origin of the arm's base in the world.",
        source="docs/reach.md",
        read_by="plan",
    )
    tool_mass_kg: Positive = setting(4.0, "Mass of the panel.", read_by="executed")


class Table(Section):
    """The table and the post that carries the specimen."""

    present: bool = setting(True, "Whether there is a table.")
    size_mm: Lengths = setting((500.0, 900.0, 50.0), "Size of the top plate along x, y, z.")
    top_z_mm: Coordinate = setting(-450.0, "Height of the upper face of the plate.")
    moved_mm: tuple[Coordinate, Coordinate] = setting(
        (0.0, 0.0),
        "Shift of the table along x, y from its usual place: below the specimen or, in an "
        "operating room, below the isocentre. A specimen beside the plate stands without a post.",
    )
    holder_radius_mm: Length = setting(30.0, "Radius of the specimen holder's post.")


DEFAULT_KIND = "arms"
_ARMS = ("source_arm", "detector_arm")
OBJECTS = "Furniture, staff, parts of the patient, and other bodies that stand in the room."


class Cell(Section):
    """The operating room: two arms, table, floor."""

    kind: Annotated[Literal["arms"], ReadBy("plan")] = DEFAULT_KIND
    source_arm: SourceArm = setting(SourceArm(), "The arm with the X-ray source.")
    detector_arm: DetectorArm = setting(DetectorArm(), "The arm with the panel.")
    table: Table = setting(Table(), "The table.", read_by="plan")
    floor_z_mm: Coordinate = setting(-1200.0, "Height of the floor.", read_by="plan")
    timestep_ms: float = setting(
        2.0, "Step of the dynamic simulation.", gt=0, le=10, read_by="executed"
    )
    zones: tuple[Zone, ...] = setting(
        (), "Forbidden zones, which the arms avoid; images do not show them.", read_by="plan"
    )
    room: Literal["plain", "operating"] = setting(
        "plain",
        "operating: an operating room around the isocentre, made of objects; its table, with "
        "mattress and column, takes the place of the plain one.",
        read_by="plan",
    )
    objects: tuple[RoomObject, ...] = setting((), OBJECTS)
    group_clearance_mm: GroupClearance = setting(
        GroupClearance(), "Additional gaps to the objects of each group.", read_by="plan"
    )

    @model_validator(mode="after")
    def _table_fits(self) -> Cell:
        height = self.table.top_z_mm - self.table.size_mm[2] - self.floor_z_mm
        if self.room == "operating" and self.table.present and height < LEAST_HEIGHT_MM:
            what = (
                f"the plate of an operating table must lie at least {LEAST_HEIGHT_MM:g} mm above "
                f"the floor, but lies {height:g} mm above it"
            )
            raise ConflictError(Conflict(what, ("table.top_z_mm", "floor_z_mm", "room")))
        return self

    @model_validator(mode="after")
    def _names_are_unique(self) -> Cell:
        require_unique_names(self.zones, "zones")
        require_unique_names([body for _, body in self.keyed_objects], "objects")
        return self

    @property
    def keyed_tools(self) -> tuple[tuple[str, Tool], ...]:
        """Tools that are described, each with its key."""
        tools = {f"cell.{side}.tool": getattr(self, side).tool for side in _ARMS}
        return tuple((key, tool) for key, tool in tools.items() if tool is not None)

    @property
    def keyed_objects(self) -> tuple[tuple[str, RoomObject], ...]:
        """All objects, those of the room first, each with the key that it comes from."""
        own = keyed(self.objects)
        if self.room == "plain":
            return own
        table = self.table
        furniture = operating_room(
            self.floor_z_mm, table.top_z_mm, table.size_mm, table.moved_mm, table=table.present
        )
        return (*(("cell.room", body) for body in furniture), *own)

    def table_middle_mm(self, specimen_mm: Sequence[float]) -> tuple[float, float]:
        """Return the middle of the table's plate along x, y.

        Args:
            specimen_mm: position of the specimen, of which x and y count.
        """
        x, y = self.table.moved_mm
        if self.room == "operating":
            return x, y + plate_middle_mm(self.table.size_mm[1])
        return x + float(specimen_mm[0]), y + float(specimen_mm[1])


class GantryCell(Section):
    """No arms: source and panel take their commanded poses, if no object stands in their way.

    Only ``uncertainty.views`` makes executed poses differ from commanded ones.
    """

    kind: Annotated[Literal["gantry"], ReadBy("plan")]
    view_s: float = setting(
        1.0,
        "Simulated time from view to view. With motion_samples above 1, each exposure is centred "
        "on the time of its view; during it, source and panel continue the screw motion from the "
        "previous view at constant speed. At the first view they stand still.",
        ge=1e-6,
        allow_inf_nan=False,
        read_by="executed",
    )
    floor_z_mm: Coordinate = setting(
        -1200.0, "Height of the floor, for pictures only.", read_by="plan"
    )
    objects: tuple[RoomObject, ...] = setting(
        (), f"{OBJECTS} A way through one that collides is refused."
    )
    source_tool: Annotated[Tool | None, ReadBy("plan")] = Field(
        default=None, description="Shapes of the tube; null: a housing of usual size."
    )
    detector_tool: Annotated[Tool | None, ReadBy("plan")] = Field(
        default=None, description="Shapes of the panel; null: a housing of usual size."
    )

    c_arm: Annotated[CArm | None, ReadBy("plan")] = Field(
        default=None,
        description="The C-arm that holds source and panel. Views that it cannot hold are refused, "
        "and it keeps away from objects, specimen and floor. null: both float in the air.",
    )

    @model_validator(mode="after")
    def _names_are_unique(self) -> GantryCell:
        require_unique_names(self.objects, "objects")
        return self

    @property
    def keyed_tools(self) -> tuple[tuple[str, Tool], ...]:
        """Tools that are described, each with its key."""
        tools = {"cell.source_tool": self.source_tool, "cell.detector_tool": self.detector_tool}
        return tuple((key, tool) for key, tool in tools.items() if tool is not None)

    @property
    def keyed_objects(self) -> tuple[tuple[str, RoomObject], ...]:
        """All objects, each with its key."""
        return keyed(self.objects)


def _kind(value: Any) -> str:
    """Return the kind that a section, or its plain data, names."""
    if isinstance(value, dict):
        return str(cast("dict[str, Any]", value).get("kind", DEFAULT_KIND))
    return str(getattr(value, "kind", DEFAULT_KIND))


AnyCell = Annotated[
    Annotated[Cell, Tag("arms")] | Annotated[GantryCell, Tag("gantry")], Discriminator(_kind)
]
