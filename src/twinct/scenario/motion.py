"""How the arms move, and when an image is taken."""

from __future__ import annotations

from typing import Literal

from twinct.settings import NonNegative, Positive, Section, setting


class InverseKinematics(Section):
    """When a joint configuration counts as solved."""

    position_tolerance_mm: Positive = setting(
        0.1,
        "Distance from the target at which an end-effector counts as there.",
        source="the paper",
    )
    rotation_tolerance_deg: Positive = setting(
        0.05, "Angle from the target at which an end-effector counts as there."
    )
    max_iterations: int = setting(200, "Steps of the solver before it gives up.", ge=1)


class Motion(Section):
    """How the arms get from view to view, and when the image is taken."""

    ik: InverseKinematics = setting(InverseKinematics(), "The inverse kinematics.")
    trigger: Literal["on_entry", "settled"] = setting(
        "on_entry",
        "on_entry: first step with both end-effectors within the tolerance, still "
        "moving; settled: at rest.",
        source="the paper",
    )
    tolerance_mm: Positive = setting(
        1.0, "Distance at which a target counts as reached.", source="the paper"
    )
    clearance_mm: NonNegative = setting(10.0, "Smallest gap between bodies that a plan may have.")
    acceleration_deg_s2: Positive = setting(300.0, "Largest joint acceleration.")
    jerk_deg_s3: Positive = setting(5000.0, "Largest joint jerk.")
    settle_speed_mm_s: Positive = setting(
        0.05, "Speed of both end-effectors below which they count as at rest."
    )
    timeout_s: Positive = setting(10.0, "Simulated time in which a move must arrive.")
