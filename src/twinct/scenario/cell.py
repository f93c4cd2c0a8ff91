"""The operating room: arms, table, floor."""

from __future__ import annotations

import difflib
import re

from pydantic import Field, field_validator

from twinct.settings import Finite, Lengths, Positive, Section, Vector, facts, setting

ARMS = ("ur10e", "lbr_iiwa14")
"""Arms that are built in."""


class Arm(Section):
    """One arm and what it carries."""

    model: str = Field(
        default="ur10e",
        description="ur10e, lbr_iiwa14, or menagerie:NAME.",
        json_schema_extra=facts(source="makers' data sheets: docs/arms.md")
        | {"pattern": r"^(ur10e|lbr_iiwa14|menagerie:[A-Za-z0-9_]+)$"},
    )
    base_position_mm: Vector = Field(description="Origin of the arm's base in the world.")
    base_rotation_deg: Vector = setting(
        (0.0, 0.0, 0.0), "Extrinsic rotations of the base about x, y, z."
    )
    standoff_mm: Positive = setting(
        150.0, "From flange to focal spot, or to panel centre, along the flange axis."
    )
    tool_rotation_deg: Finite = setting(
        0.0, "Turn of the tool about the flange axis when it was mounted."
    )
    tool_mass_kg: Positive = Field(description="Mass of the tool.")
    torque_scale: float = setting(
        1.0,
        "Share of the published torque limits that may be used.",
        gt=0,
        le=1,
        source="limits: the maker's",
    )
    speed_scale: float = setting(
        0.5,
        "Share of the published joint speeds that a move may use.",
        gt=0,
        le=1,
        source="limits: the maker's",
    )
    joint_speed_deg_s: Positive = setting(
        90.0, "Limit of every joint's speed, for a Menagerie model: those state none."
    )

    @field_validator("model")
    @classmethod
    def _known_model(cls, model: str) -> str:
        menagerie, colon, name = model.partition(":")
        if model in ARMS or (menagerie == "menagerie" and re.fullmatch(r"\w+", name)):
            return model
        near = difflib.get_close_matches(model, ARMS, n=1)
        hint = f"; did you mean {near[0]!r}?" if near and not colon else ""
        raise ValueError(
            f"{model!r} is no arm{hint} (known: {', '.join(ARMS)}, and menagerie:NAME for one of "
            "MuJoCo Menagerie)"
        )


class SourceArm(Arm):
    """The arm with the X-ray source."""

    base_position_mm: Vector = setting((850.0, 0.0, 0.0), "Origin of the arm's base in the world.")
    base_rotation_deg: Vector = setting(
        (0.0, 0.0, 180.0), "Extrinsic rotations of the base about x, y, z."
    )
    tool_mass_kg: Positive = setting(8.0, "Mass of the X-ray source.")


class DetectorArm(Arm):
    """The arm with the panel."""

    base_position_mm: Vector = setting((-850.0, 0.0, 0.0), "Origin of the arm's base in the world.")
    tool_mass_kg: Positive = setting(4.0, "Mass of the panel.")


class Table(Section):
    """The table and the post that carries the specimen."""

    present: bool = setting(True, "Whether there is a table.")
    size_mm: Lengths = setting((500.0, 900.0, 50.0), "Top plate along x, y, z.")
    top_z_mm: Finite = setting(-450.0, "Height of the upper face of the plate.")
    holder_radius_mm: Positive = setting(30.0, "Radius of the specimen holder's post.")


class Cell(Section):
    """The operating room: two arms, table, floor."""

    source_arm: SourceArm = setting(SourceArm(), "The arm with the X-ray source.")
    detector_arm: DetectorArm = setting(DetectorArm(), "The arm with the panel.")
    table: Table = setting(Table(), "The table.")
    floor_z_mm: Finite = setting(-1200.0, "Height of the floor.")
    timestep_ms: float = setting(2.0, "Step of the dynamic simulation.", gt=0, le=10)
