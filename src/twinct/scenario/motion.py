"""Motion of the arms, and the trigger of each image."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from twinct.settings import Length, NonNegative, Positive, Section, setting


class InverseKinematics(Section):
    """Criteria by which a joint configuration counts as solved."""

    position_tolerance_mm: Length = setting(
        0.1,
        "Distance from the target at which an end-effector counts as there.",
        source="the paper",
    )
    rotation_tolerance_deg: Positive = setting(
        0.05, "Angle from the target at which an end-effector counts as there."
    )
    max_iterations: int = setting(200, "Steps of the solver before it gives up.", ge=1)


class Motion(Section):
    """Motion of the arms from view to view, and the trigger of each image."""

    ik: InverseKinematics = setting(InverseKinematics(), "The inverse kinematics.")
    trigger: Literal["on_entry", "settled"] = setting(
        "on_entry",
        "on_entry: first step with both end-effectors within the tolerance, still "
        "moving; settled: at rest.",
        source="the paper",
    )
    tolerance_mm: Length = setting(
        1.0, "Distance at which a target counts as reached.", source="the paper"
    )
    clearance_mm: NonNegative = setting(10.0, "Smallest gap between bodies that a plan may have.")
    scheme: Literal["planned", "reactive"] = setting(
        "planned",
        "planned: the arms follow the plan, and triggers only take images; reactive: each target "
        "is solved when it arrives, from the joints as they are (the paper's figure 2).",
    )
    plan: Path | None = setting(
        None,
        "File of a plan (twinct check --save) that the arms shall follow; it is checked against "
        "cell, views and limits. None: the plan is made.",
    )
    order: Literal["given", "shortest"] = setting(
        "given",
        "Order in which the views are taken; shortest: a tour on which the arms move little, from "
        "view 0 on.",
    )
    source_roll: Literal["auto", "free", "fixed"] = setting(
        "auto",
        "Whether the source may be turned about its axis. auto: where the panel may and the focal "
        "spot looks the same from all sides.",
    )
    detector_roll: Literal["auto", "free", "fixed"] = setting(
        "auto",
        "Whether the panel may be turned about its normal. auto: where the trajectory gives no "
        "axes of the panel (a file of S and D).",
    )
    tool_speed_mm_s: Positive | None = setting(
        None,
        "Speed of the faster tool that a plan keeps to where nothing else limits it; none: as fast "
        "as the joints' limits let it.",
    )
    settle_s: Positive = setting(
        0.35, "Time at rest that a plan gives each view with trigger: settled."
    )
    acceleration_deg_s2: Positive = setting(300.0, "Largest joint acceleration.")
    jerk_deg_s3: Positive = setting(5000.0, "Largest joint jerk.")
    settle_speed_mm_s: Positive = setting(
        0.05, "Speed of both end-effectors below which they count as at rest."
    )
    timeout_s: Positive = setting(
        10.0,
        "Simulated time in which a move must arrive; with scheme: planned, how much later than "
        "planned the last one may.",
    )
