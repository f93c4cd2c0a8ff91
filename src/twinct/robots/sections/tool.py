"""Tube or panel of an arm or a gantry, described by shapes instead of the usual housing."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from twinct.core.settings import Conflict, ConflictError, ReadBy, Section, Vector, setting
from twinct.geometry import Pose
from twinct.specimen.sections import Box, Capsule, CShape, Cylinder, MeshFile, Sphere
from twinct.specimen.sections.room_objects import COLOUR, rgba_of


class ToolPart(Section):
    """One shape of a tool."""

    shape: Annotated[
        Box | Sphere | Cylinder | Capsule | CShape | MeshFile,
        Field(discriminator="kind"),
        ReadBy("plan"),
    ] = Field(description="Shape. Convex bodies that hold it collide in place of a mesh.")
    position_mm: Vector = setting(
        (0.0, 0.0, 0.0), "Centre, or origin of a mesh, in the tool's frame.", read_by="plan"
    )
    rotation_deg: Vector = setting(
        (0.0, 0.0, 0.0), "Extrinsic rotations about x, y, z.", read_by="plan"
    )
    colour: str = setting(
        "#d9dcde", "Colour in pictures, as for an object of the room.", pattern=COLOUR
    )

    @property
    def tool_from_part(self) -> Pose:
        """Pose of the shape in the tool's frame."""
        return Pose.from_euler(self.position_mm, self.rotation_deg)

    @property
    def rgba(self) -> tuple[float, float, float, float]:
        """Red, green, blue and opacity, in [0, 1]."""
        return rgba_of(self.colour)


class Tool(Section):
    """A tube or a panel: its shapes, and where the focal spot or the active area is.

    The tool's frame has its origin on the face that is mounted, and z pointing away from the arm,
    as drawings of tools have it.
    """

    parts: Annotated[tuple[ToolPart, ...], ReadBy("plan")] = Field(
        min_length=1, description="Shapes, which may overlap."
    )
    tip_mm: Annotated[Vector, ReadBy("plan")] = Field(
        description="Focal spot, or centre of the panel's active area, in the tool's frame."
    )
    tip_rotation_deg: Vector = setting(
        (0.0, 0.0, 0.0),
        "Extrinsic rotations about x, y, z of the frame at the tip: its z is the beam's direction "
        "for a tube; for a panel, the normal towards the source, with x along the rows.",
        read_by="plan",
    )
    centre_of_mass_mm: Annotated[Vector | None, ReadBy("executed")] = Field(
        default=None,
        description="Centre of mass in the tool's frame; null: that of the parts, with one "
        "density.",
    )

    @model_validator(mode="after")
    def _tip_is_ahead(self) -> Tool:
        if self.tip_mm[2] <= 0:
            what = f"tip_mm must lie at z > 0, away from the arm, but lies at {self.tip_mm[2]:g} mm"
            raise ConflictError(Conflict(what, ("tip_mm",)))
        return self

    @property
    def tool_from_tip(self) -> Pose:
        """Pose of focal spot or active area in the tool's frame."""
        return Pose.from_euler(self.tip_mm, self.tip_rotation_deg)
