"""Bodies that stand in the room: objects, which may collide and attenuate, and forbidden zones."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field, model_validator

from twinct.core.settings import (
    Conflict,
    ConflictError,
    Length,
    Lengths,
    NonNegative,
    ReadBy,
    Section,
    Vector,
    setting,
)
from twinct.geometry import Pose
from twinct.specimen.sections.composition import Composition
from twinct.specimen.sections.specimen import Box, Cylinder, MeshFile, Sphere

LEAST_HEIGHT_MM = 450.0
"""Smallest height of the plate of an operating table above the floor."""

COLOUR = r"^#([0-9a-fA-F]{6}|[0-9a-fA-F]{8})$"
"""Pattern of colours."""

Group = Literal["patient", "staff", "furniture"]


class Capsule(Section):
    """A cylinder with round ends along the body's z axis, centred."""

    kind: Literal["capsule"]
    radius_mm: Length = Field(description="Radius.")
    length_mm: Length = Field(description="Distance between the centres of the round ends.")


class CShape(Section):
    """Three plates, centred like a box: a back at -z, and legs at -x and +x; open towards +z."""

    kind: Literal["c_shape"]
    size_mm: Lengths = Field(description="Outer size along x, y, z.")
    wall_mm: Length = Field(description="Thickness of the plates.")

    @model_validator(mode="after")
    def _is_open(self) -> CShape:
        if 2 * self.wall_mm >= self.size_mm[0] or self.wall_mm >= self.size_mm[2]:
            what = (
                f"wall_mm = {self.wall_mm:g} leaves nothing open of "
                f"{' x '.join(f'{edge:g}' for edge in self.size_mm)} mm"
            )
            raise ConflictError(Conflict(what, ("wall_mm",)))
        return self


class Standing(Section):
    """Keys of everything that stands in the room."""

    name: str = Field(min_length=1, description="Name in messages; unique.")
    position_mm: Vector = setting(
        (0.0, 0.0, 0.0), "Centre, or origin of a mesh, in the world.", read_by="plan"
    )
    rotation_deg: Vector = setting(
        (0.0, 0.0, 0.0), "Extrinsic rotations about x, y, z.", read_by="plan"
    )

    @property
    def world_from_body(self) -> Pose:
        """Pose of the shape in the world."""
        return Pose.from_euler(self.position_mm, self.rotation_deg)


class Zone(Standing):
    """Part of the room that the arms must not enter, such as a patient's shoulders or staff."""

    shape: Annotated[Box | Sphere | Cylinder | Capsule, Field(discriminator="kind")] = Field(
        description="Shape of the zone."
    )


class RoomObject(Standing):
    """A body that stands in the room, such as a table, a lamp or a patient's arm."""

    shape: Annotated[
        Box | Sphere | Cylinder | Capsule | CShape | MeshFile,
        Field(discriminator="kind"),
        ReadBy("plan"),
    ] = Field(
        description="Shape. Arms keep away from convex bodies that hold a mesh; twinct check "
        "states how closely."
    )
    group: Group = setting(
        "furniture",
        "Group, which sets the gap that arms keep (cell.group_clearance_mm). Objects of one group "
        "may overlap each other; all other fixed bodies must stand apart.",
        read_by="plan",
    )
    collides: bool = setting(True, "Whether the arms keep away from the object.", read_by="plan")
    material: str | Composition | None = setting(
        None,
        "Material, as for a part of the specimen, of an object that attenuates the beam; null: the "
        "images do not show the object. Where such objects overlap, the later one wins.",
        source="attenuation: xraylib",
        read_by="images",
    )
    colour: str = setting(
        "#9aa4ad",
        "Colour in pictures, as #rrggbb; #rrggbbaa is translucent.",
        pattern=COLOUR,
    )

    @property
    def rgba(self) -> tuple[float, float, float, float]:
        """Red, green, blue and opacity, in [0, 1]."""
        return rgba_of(self.colour)


class GroupClearance(Section):
    """Gap that the arms keep from objects of a group, in addition to ``motion.clearance_mm``.

    Clearances in reports leave it out, as with ``specimen.safety_mm``.
    """

    patient: NonNegative = setting(0.0, "Objects of the group patient.", unit="mm")
    staff: NonNegative = setting(0.0, "Objects of the group staff.", unit="mm")
    furniture: NonNegative = setting(0.0, "Objects of the group furniture.", unit="mm")


def rgba_of(colour: str) -> tuple[float, float, float, float]:
    """Return red, green, blue and opacity, in [0, 1], of a colour as #rrggbb or #rrggbbaa."""
    red, green, blue, *opacity = bytes.fromhex(colour[1:])
    return red / 255, green / 255, blue / 255, (opacity[0] / 255 if opacity else 1.0)


def keyed(objects: Sequence[RoomObject]) -> tuple[tuple[str, RoomObject], ...]:
    """Return the objects of a cell's section, each with its key."""
    return tuple((f"cell.objects.{index}", body) for index, body in enumerate(objects))


def require_unique_names(bodies: Sequence[Standing], key: str) -> None:
    """Raise ``ConflictError`` if two bodies of a list, such as zones, have the same name."""
    names = [body.name for body in bodies]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        what = f"{', '.join(twice)}: two {key} have the same name"
        raise ConflictError(Conflict(what, (key,)))
