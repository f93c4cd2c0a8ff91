"""The shortest scan against bounds: frames of the detector, and a time-optimal parametrisation.

    python -m pip install --target /tmp/toppra --no-deps toppra
    PYTHONPATH=/tmp/toppra python benchmarks/bench_shortest.py             # the paper's cell
    PYTHONPATH=/tmp/toppra python benchmarks/bench_shortest.py --default   # the default cell

An arc of 400 views over 200 deg by two UR10e, 30 frames a second. No scan can be shorter than the
time of its frames, nor than a law along its joint path that toppra finds within the limits of joint
speed, acceleration and torque, without limits of jerk and without regard to views. The third bound
takes the detector's time from view to view as one more limit of that law. The path is the spline
through the knots of the plan's own law. A plan with ``LOOSER`` times the jerk shows what the limit
of jerk costs. The fourth bound holds for every path and every law: the
closed form gives all configurations of every view, and between two views the joints take at least
their way at full speed. Exit code 1 where the plan takes more than ``--most`` times the larger one
of the first two bounds.
"""

# pyright: reportMissingImports=false
# toppra is no dependency of the project.

from __future__ import annotations

import argparse
import json
import sys
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import toppra
import toppra.algorithm
import toppra.constraint

from twinct.robots.motion.feasible import Feasible
from twinct.robots.motion.layers import LayerSearch, speeds_of
from twinct.robots.motion.path_search import find_joint_path, required_gap_mm
from twinct.robots.motion.plan import KNOT_RAD, timed
from twinct.robots.motion.timing import TORQUE_SHARE
from twinct.robots.motion.view_configurations import ViewConfigurations
from twinct.scan import SimulationBuilder
from twinct.scenario import load_scenario

SCENARIO = Path(__file__).parents[1] / "scenarios" / "demo.yaml"
DEFAULT = {"specimen": {"parts": [{"shape": {"kind": "sphere", "radius_mm": 80}}]}}
FRAME_S = 1 / 30
KEPT_RAD = 0.25
"""Largest change of a joint from view to view within one configuration."""
LOOSER = 4
CHANGES: dict[str, Any] = {
    "trajectory": {"kind": "arc", "views": 400, "longitude_range_deg": 200},
    "detector.frame_ms": 1000 * FRAME_S,
    "motion.tool_speed_mm_s": None,
}


def optimal_s(
    builder: SimulationBuilder, knots: np.ndarray, views: np.ndarray, frame_s: float
) -> float:
    """Return the time of toppra's law along the spline through some knots, rest to rest.

    Args:
        builder: simulations of the scan.
        knots: joint positions, rad, (knots, n).
        views: knots at which a view is taken.
        frame_s: least time from view to view; 0 for none.
    """
    cell, motion = builder.cell, builder.scenario.motion
    speeds = cell.speed_limits * cell.speed_scales
    spans = np.maximum((np.abs(np.diff(knots, axis=0)) / speeds).max(axis=1), 1e-9)
    passed = np.concatenate([[0.0], np.cumsum(spans)])
    path = toppra.SplineInterpolator(passed, knots, "not-a-knot")
    limit = np.full(len(speeds), np.radians(motion.acceleration_deg_s2))
    model, data = cell.model, mujoco.MjData(cell.model)

    def torques(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        data.qpos[:], data.qvel[:], data.qacc[:] = q, v, a
        for step in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_comVel):
            step(model, data)
        found = np.zeros(model.nv)
        mujoco.mj_rne(model, data, 1, found)
        return found + model.dof_armature * a

    def fastest(s: float) -> np.ndarray:
        most, stretch = speeds, np.searchsorted(passed[views], s)
        if frame_s and 0 < stretch < len(views):
            share = np.diff(passed[views])[stretch - 1] / frame_s
            most = np.minimum(most, np.abs(path(s, 1)) * share + 1e-9)
        return np.stack([-most, most], axis=1)

    friction = model.dof_frictionloss
    most = TORQUE_SHARE * cell.torque_limits - friction
    constraint = toppra.constraint
    limits = [
        constraint.JointVelocityConstraintVarying(fastest),
        constraint.JointAccelerationConstraint(np.stack([-limit, limit], axis=1)),
        constraint.JointTorqueConstraint(
            torques, np.stack([-most, most], axis=1), np.zeros(len(speeds))
        ),
    ]
    grid = np.linspace(0.0, float(passed[-1]), 6 * len(knots))
    law = toppra.algorithm.TOPPRA(
        limits, path, gridpoints=grid, parametrizer="ParametrizeConstAccel"
    )
    return float(law.compute_trajectory(0, 0).duration)


def least_s(builder: SimulationBuilder) -> tuple[float, list[int]]:
    """Return the least time of any scan, and for each arm the configurations that hold all views.

    Joints may move at full speed at once. Configurations of neighbouring views are taken for one if
    no joint differs by more than ``KEPT_RAD``.
    """
    cell, motion, targets = builder.cell, builder.scenario.motion, list(builder.targets)
    least_mm = required_gap_mm(motion)
    views = ViewConfigurations(cell, motion, targets, (False, False), least_mm, 0)
    arms = [[of.joints for of in views.of_arm(arm)[0]] for arm in range(2)]
    through = []
    for layers, speeds in zip(arms, speeds_of(cell), strict=True):
        open_ = np.ones(len(layers[0]), bool)
        for a, b in pairwise(layers):
            near = speeds.seconds(a, b) < KEPT_RAD / speeds.limits.max()
            open_ = (open_[:, None] & near).any(axis=0)
        through.append(int(open_.sum()))
    cross, speeds = Feasible(cell, "cross"), speeds_of(cell)
    nodes = []
    for source, detector in zip(*arms, strict=True):
        pairs = np.array([np.hstack([a, b]) for a in source for b in detector])
        nodes.append(pairs[cross.clear(pairs, least_mm)])
    frame_s = builder.shutter.frame_s
    costs = [
        np.max(
            [
                of.seconds(a[:, part], b[:, part])
                for of, part in zip(speeds, cell.arm_joints, strict=True)
            ],
            axis=0,
        ).clip(frame_s)
        for a, b in pairwise(nodes)
    ]
    return LayerSearch(costs, [np.zeros(len(layer)) for layer in nodes]).best()[1], through


def main(most: float, default: bool) -> int:
    builder = SimulationBuilder(load_scenario(DEFAULT if default else SCENARIO, CHANGES))
    motion, begun = builder.scenario.motion, time.process_time()
    way = find_joint_path(builder.cell, motion, builder.targets)
    plan = timed(builder.cell, motion, way, builder.shutter)
    planned_s = time.process_time() - begun
    looser = motion.model_copy(update={"jerk_deg_s3": LOOSER * motion.jerk_deg_s3})
    knots, own = [way.joints[:1]], [0]
    for start, end in zip(way.joints[:-1], way.joints[1:], strict=True):
        parts = max(1, int(np.ceil(np.abs(end - start).max() / KNOT_RAD)))
        knots.append(start + np.arange(1, parts + 1)[:, None] / parts * (end - start))
        own.append(own[-1] + parts)
    at, views = np.vstack(knots), np.array(own)[way.views >= 0]
    best_s, framed_s = (optimal_s(builder, at, views, least_s) for least_s in (0.0, FRAME_S))
    frames_s = len(plan.targets) * FRAME_S
    ratio = plan.duration_s / max(best_s, frames_s)
    between = np.diff(plan.exposures_s)
    lowest_s, through = least_s(builder)
    told = {
        "scan, s": plan.duration_s,
        "first and last view, s": [plan.exposures_s[0], plan.exposures_s[-1]],
        "with more jerk, s": timed(builder.cell, looser, way, builder.shutter).duration_s,
        "frames, s": frames_s,
        "toppra, s": best_s,
        "ratio": ratio,
        "toppra with frames, s": framed_s,
        "ratio to it": plan.duration_s / framed_s,
        "any path and law, s": lowest_s,
        "that against the frames": lowest_s / frames_s,
        "configurations of source and detector arm for all views": through,
        "least, mean and longest time between views, ms": [
            1000 * float(of(between)) for of in (np.min, np.mean, np.max)
        ],
        "processor seconds": planned_s,
    }
    print(json.dumps(told))
    return int(ratio > most)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="The shortest scan")
    parser.add_argument("--most", type=float, default=1.1)
    parser.add_argument("--default", action="store_true")
    args = parser.parse_args()
    sys.exit(main(args.most, args.default))
