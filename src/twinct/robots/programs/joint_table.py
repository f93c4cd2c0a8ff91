"""A motion plan as a plain table: a row for each waypoint."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping

from twinct.robots.cell.rails import JOINT as RAIL_JOINT
from twinct.robots.motion.branches import SIDES
from twinct.robots.programs.language import Language
from twinct.robots.programs.program import TRIGGERS, Program, triggers

KINDS = ("", "_s", "_s2")
"""Endings of the units of positions, velocities and accelerations."""


def _write(program: Program) -> Mapping[str, str]:
    plan = program.plan
    # The names of both drivers may be the same, so that the side is always told.
    joints = [
        f"{side}_{name}" for side, names in zip(SIDES, program.names, strict=True) for name in names
    ]
    stream = io.StringIO()
    rows = csv.writer(stream, lineterminator="\n")
    units = ["m" if name.endswith(RAIL_JOINT) else "rad" for name in plan.joint_names]
    named = [f"{name}_{unit}" for name, unit in zip(joints, units, strict=True)]
    rows.writerow(["time_s", "view", *(f"{name}{kind}" for kind in KINDS for name in named)])
    for time_s, view, state in zip(
        plan.time_s.tolist(), plan.views.tolist(), plan.state, strict=True
    ):
        numbers = map(repr, state.ravel().tolist())
        rows.writerow([repr(time_s), "" if view < 0 else view, *numbers])
    return {"plan.csv": stream.getvalue(), TRIGGERS: triggers(program)}


JOINT_TABLE = Language("csv", "a table of times and joints, rad, m and s", _write)
