"""Motion of the arms, and the trigger of each image."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from twinct.core.settings import Length, NonNegative, Positive, Section, setting


class InverseKinematics(Section):
    """Criteria by which a joint configuration counts as solved."""

    position_tolerance_mm: Length = setting(
        0.1,
        "Distance from the target within which an end-effector counts as on target.",
        source="the paper",
    )
    rotation_tolerance_deg: Positive = setting(
        0.05, "Angle from the target within which an end-effector counts as on target."
    )
    max_iterations: int = setting(200, "Steps of the solver before it gives up.", ge=1)


class Motion(Section):
    """Motion of the arms from view to view, and the trigger of each image."""

    ik: InverseKinematics = setting(InverseKinematics(), "The inverse kinematics.", read_by="plan")
    trigger: Literal["on_entry", "settled"] = setting(
        "on_entry",
        "Moment at which an image is triggered. on_entry: at the first step with both "
        "end-effectors within the tolerance, while they still move; settled: when they are at "
        "rest.",
        source="the paper",
        read_by="executed",
    )
    tolerance_mm: Length = setting(
        1.0,
        "Distance from a target within which it counts as reached.",
        source="the paper",
        read_by="executed",
    )
    clearance_mm: NonNegative = setting(
        10.0, "Smallest gap between bodies that a plan may have.", read_by="plan"
    )
    scheme: Literal["planned", "reactive"] = setting(
        "planned",
        "planned: the arms follow the plan, and triggers only take images; reactive: each "
        "target is solved on arrival, from the current joint positions (the paper's figure 2).",
        read_by="plan",
    )
    plan: Path | None = setting(
        None,
        "Plan file (twinct check --save) that the arms follow; it is checked against cell, "
        "views and limits. null: a plan is made.",
        read_by="plan",
    )
    order: Literal["given", "shortest"] = setting(
        "given",
        "Order in which the views are taken; shortest: a tour with little arm motion, starting "
        "at view 0.",
        read_by="plan",
    )
    source_roll: Literal["auto", "free", "fixed"] = setting(
        "auto",
        "Whether the source may turn about its axis. auto: only if the panel may turn and the "
        "focal spot is rotationally symmetric.",
        read_by="plan",
    )
    detector_roll: Literal["auto", "free", "fixed"] = setting(
        "auto",
        "Whether the panel may turn about its normal. auto: only if the trajectory gives no "
        "panel axes (a file of S and D).",
        read_by="plan",
    )
    tool_speed_mm_s: Positive | None = setting(
        None,
        "Largest speed of the faster tool where a plan takes views; null: only the joints' limits "
        "apply, as on detours.",
        read_by="executed",
    )
    settle_s: Positive | None = setting(
        None,
        "Time at rest that a plan allows for each view with trigger: settled. null: as long as the "
        "servos of the simulation need; state a time for real arms.",
        read_by="executed",
    )
    acceleration_deg_s2: Positive = setting(
        300.0, "Largest joint acceleration.", read_by="executed"
    )
    jerk_deg_s3: Positive = setting(5000.0, "Largest joint jerk.", read_by="executed")
    settle_speed_mm_s: Positive = setting(
        0.05, "Speed of both end-effectors below which they count as at rest.", read_by="executed"
    )
    timeout_s: Positive = setting(
        10.0,
        "Simulated time within which a move must arrive; with scheme: planned, the largest delay "
        "of the last move behind the plan.",
        read_by="executed",
    )
