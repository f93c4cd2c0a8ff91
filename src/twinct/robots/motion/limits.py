"""Limits that determine the duration of a motion plan, for the report of a check."""

from __future__ import annotations

from collections import Counter

import numpy as np

from twinct.geometry import MM_PER_M, Floats
from twinct.robots.cell import CellModel
from twinct.robots.motion.branches import SIDES
from twinct.robots.motion.plan import MotionPlan
from twinct.robots.motion.shutter import Shutter
from twinct.robots.motion.timing import STEP_SHARE, TimeLaw
from twinct.robots.sections import Motion

STEP_S = 0.01
"""Time step at which a plan is looked at, s."""

AT_LEAST = 1.01
"""Factor of the least time between two views up to which that time limits the motion."""

STILL_RAD = 1e-9
"""Speed and acceleration below which the plan rests, up to rounding."""


def limiting(
    plan: MotionPlan, cell: CellModel, motion: Motion, shutter: Shutter
) -> dict[str, float]:
    """Return the share of the plan's duration for which each limit is the nearest one.

    Args:
        plan: the plan.
        cell: robot cell.
        motion: limits of joints and tools.
        shutter: duration of an exposure, and least time from view to view.

    Returns:
        Shares by scenario key with its value, the largest first.
    """
    time_s = np.arange(0.0, plan.duration_s, STEP_S)
    used = _used(plan.at(time_s), cell, motion)
    names, values = list(used), np.array(list(used.values()))
    nearest = [names[row] for row in values.argmax(axis=0)]
    paced = _paced(plan, time_s, shutter.interval_s(cell.model.opt.timestep))
    resting = np.abs(plan.at(time_s)[:, 1:]).max(axis=(1, 2)) < STILL_RAD
    counts = Counter(
        shutter.limit
        if by_detector
        else f"motion.settle_s = {'null' if motion.settle_s is None else f'{motion.settle_s:g}'}"
        if rests
        else by_arms
        for by_arms, by_detector, rests in zip(nearest, paced, resting, strict=True)
    )
    return {name: count / len(time_s) for name, count in counts.most_common()}


def _used(states: Floats, cell: CellModel, motion: Motion) -> dict[str, Floats]:
    """Return the share of each limit that the motion uses at each time, by key, (times,)."""
    law = TimeLaw(cell, motion)
    shares = law.shares(states)
    used: dict[str, Floats] = {}
    for side, part in zip(SIDES, cell.arm_joints, strict=True):
        arm = getattr(cell.cell, f"{side}_arm")
        used[f"cell.{side}_arm.speed_scale = {arm.speed_scale:g}"] = shares["speed"][:, part].max(1)
        used[f"cell.{side}_arm.torque_scale = {arm.torque_scale:g}"] = shares["torque"][
            :, part
        ].max(1)
    key = f"motion.acceleration_deg_s2 = {motion.acceleration_deg_s2:g}"
    used[key] = shares["acceleration"].max(axis=1)
    jerk = np.abs(np.gradient(states[:, 2], STEP_S, axis=0)).max(axis=1)
    used[f"motion.jerk_deg_s3 = {motion.jerk_deg_s3:g}"] = jerk / np.radians(motion.jerk_deg_s3)
    speeds_mm_s = law.tool_speeds_m_s(states[:, 0], states[:, 1]) * MM_PER_M
    if motion.tool_speed_mm_s is not None:
        key = f"motion.tool_speed_mm_s = {motion.tool_speed_mm_s:g}"
        used[key] = speeds_mm_s / motion.tool_speed_mm_s
    if motion.trigger == "on_entry":
        most_mm_s = STEP_SHARE * motion.tolerance_mm / cell.model.opt.timestep
        used[f"motion.tolerance_mm = {motion.tolerance_mm:g}"] = speeds_mm_s / most_mm_s
    return used


def _paced(plan: MotionPlan, time_s: Floats, interval_s: float) -> list[bool]:
    """Return flags of the times between two views that follow each other as soon as they may."""
    at = plan.exposures_s
    tight = np.concatenate([[False], np.diff(at) <= AT_LEAST * interval_s, [False]])
    return tight[np.searchsorted(at, time_s)].tolist()
