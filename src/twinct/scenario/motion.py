"""How the arms move, and when an image is taken."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from twinct.settings import NonNegative, Positive, Section, facts


class InverseKinematics(Section):
    """When a joint configuration counts as solved."""

    position_tolerance_mm: Positive = Field(
        default=0.1,
        description="Distance from the target at which an end-effector counts as there.",
        json_schema_extra=facts(source="the paper"),
    )
    rotation_tolerance_deg: Positive = Field(
        default=0.05, description="Angle from the target at which an end-effector counts as there."
    )
    max_iterations: int = Field(
        default=200, ge=1, description="Steps of the solver before it gives up."
    )


class Motion(Section):
    """How the arms get from view to view, and when the image is taken."""

    ik: InverseKinematics = Field(
        default=InverseKinematics(), description="The inverse kinematics."
    )
    trigger: Literal["on_entry", "settled"] = Field(
        default="on_entry",
        description="on_entry: first step with both end-effectors within the tolerance, still "
        "moving; settled: at rest.",
        json_schema_extra=facts(source="the paper"),
    )
    tolerance_mm: Positive = Field(
        default=1.0,
        description="Distance at which a target counts as reached.",
        json_schema_extra=facts(source="the paper"),
    )
    clearance_mm: NonNegative = Field(
        default=10.0, description="Smallest gap between bodies that a plan may have."
    )
    acceleration_deg_s2: Positive = Field(default=300.0, description="Largest joint acceleration.")
    jerk_deg_s3: Positive = Field(default=5000.0, description="Largest joint jerk.")
    settle_speed_mm_s: Positive = Field(
        default=0.05, description="Speed of both end-effectors below which they count as at rest."
    )
    timeout_s: Positive = Field(
        default=10.0, description="Simulated time in which a move must arrive."
    )
