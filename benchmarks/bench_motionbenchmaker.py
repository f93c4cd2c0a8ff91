"""Joint goals of MotionBenchMaker, by the library's search for detours and by plain RRT-Connect.

    python benchmarks/bench_motionbenchmaker.py FOLDER [--per-set 100] [--seed 62] [--seconds 10]

FOLDER holds arms.tar.gz, ur5.tar.bz2 and panda.tar.bz2: 7 sets of 100 problems for each arm
(Chamzas et al., "MotionBenchMaker", IEEE RA-L 7, 2022; meshes and problems from KavrakiLab/vamp).
Start and goal are joint positions, obstacles are primitives. Pairs of links are those that neither
the SRDF nor the scene's matrix allows to touch; links are the convex hulls of their meshes, as
everywhere in twinct. A sample of each set is drawn by seed.

Ours is what a path search does from view to view: a straight path if it is clear, else OMPL's
RRT-Connect with shortcuts, with straight segments that are proven clear. The other is RRT-Connect
of OMPL with its defaults and its default simplification, on the same checks and with the same
spacing. Both run in pairs, and time is that of the processor. Paths are judged by coal at steps of
1 mm of the fastest point. One JSON line a set, then all.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
import tarfile
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import yaml

from twinct.geometry import Floats
from twinct.robots.cell.collision_pairs import levers
from twinct.robots.motion.collision_check import CollisionCheck
from twinct.robots.motion.feasible import Feasible
from twinct.robots.motion.path_planner import SEARCHES, Detours, _ompl

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
from coal_distances import CoalDistances  # noqa: E402

ARMS = ("panda", "ur5")
LEAST_MM = 0.2
"""Clearance of our paths: the proof of a straight path may fall short by half as much."""

STEP_M = 0.001


@dataclass
class Problem:
    """One arm among obstacles, as the planner takes a cell, and two configurations."""

    cell: Any
    start: Floats
    goal: Floats


def robot(folder: Path, arm: str) -> str:
    """Return the URDF with absolute paths of meshes, without pictures."""
    file = folder / "resources" / arm / f"{arm}.urdf"
    root = ElementTree.parse(file).getroot()
    for link in root.findall("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
        inertial = link.find("inertial")
        if inertial is not None:  # for planning, only shapes and joints count
            link.remove(inertial)
    there = {path.stem.lower(): path for path in (file.parent / "meshes").rglob("*.*")}
    for link in root.findall("link"):
        for collision in link.findall("collision"):
            mesh = collision.find("geometry/mesh")
            if mesh is None:
                continue
            path = file.parent / mesh.get("filename", "").partition("://")[2]
            if not path.is_file():  # coarse meshes stand in for fine ones
                path = there.get(f"{path.stem.lower()}_coarse", path)
            mesh.set("filename", str(path))
            if not path.is_file():  # the force sensor's, which no archive has
                link.remove(collision)
    ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler").attrib = {
        "fusestatic": "false", "discardvisual": "false", "strippath": "false",
        "boundmass": "0.1", "boundinertia": "0.001",
    }  # fmt: skip
    return ElementTree.tostring(root, encoding="unicode")


def allowed(folder: Path, arm: str, scene: dict[str, Any]) -> set[frozenset[str]]:
    """Return the pairs of links that may touch, by the SRDF and the scene's matrix."""
    srdf = ElementTree.parse(folder / "resources" / arm / f"{arm}.srdf").getroot()
    pairs = {
        frozenset((p.get("link1", ""), p.get("link2", "")))
        for p in srdf.findall("disable_collisions")
    }
    matrix = scene["allowed_collision_matrix"]
    names = matrix["entry_names"]
    for one, row in zip(names, matrix["entry_values"], strict=True):
        pairs |= {frozenset((one, other)) for other, yes in zip(names, row, strict=True) if yes}
    return pairs


def add_obstacles(spec: Any, scene: dict[str, Any]) -> None:
    """Add the primitives of a scene."""
    kinds = {
        "box": mujoco.mjtGeom.mjGEOM_BOX, "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
        "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    }  # fmt: skip
    for number, thing in enumerate(scene["world"]["collision_objects"]):
        body = spec.worldbody.add_body(name=f"obstacle {number}")
        parts = zip(thing["primitives"], thing["primitive_poses"], strict=True)
        for primitive, pose in parts:
            size = np.array(primitive["dimensions"], float)
            if primitive["type"] == "cylinder":  # height, radius
                size = np.array([size[1], size[0] / 2, 0.0])
            elif primitive["type"] == "box":
                size = size / 2
            body.add_geom(
                type=kinds[primitive["type"]], size=np.resize(np.append(size, [0, 0]), 3),
                pos=pose["position"], quat=np.roll(pose["orientation"], 1),
            )  # fmt: skip


def problem(folder: Path, name: str, number: int) -> Problem:
    """Return a problem."""
    arm = name.rpartition("_")[2]
    files = folder / "problems" / name
    scene, request = (
        yaml.load((files / f"{kind}{number:04d}.yaml").read_text(), yaml.CSafeLoader)
        for kind in ("scene", "request")
    )
    spec = mujoco.MjSpec.from_string(robot(folder, arm))
    add_obstacles(spec, scene)
    model = spec.compile()
    names = [model.joint(j).name for j in range(model.njnt)]
    of_start = request["start_state"]["joint_state"]
    start = dict(zip(of_start["name"], of_start["position"], strict=True))
    goal = {
        c["joint_name"]: c["position"] for c in request["goal_constraints"][0]["joint_constraints"]
    }
    may = allowed(folder, arm, scene)
    solid = np.flatnonzero(model.geom_contype | model.geom_conaffinity)
    welded = model.body_weldid
    pairs = [
        (a, b)
        for k, a in enumerate(solid.tolist())
        for b in solid[k + 1 :].tolist()
        if welded[model.geom_bodyid[a]] != welded[model.geom_bodyid[b]]
        and frozenset(model.body(model.geom_bodyid[g]).name for g in (a, b)) not in may
    ]
    n = model.njnt
    cell = SimpleNamespace(
        model=model, pairs=np.array(pairs), margins=np.zeros(model.ngeom), lever=levers(model),
        arm_joints=(slice(0, n), slice(n, n)), joint_ranges=model.jnt_range,
        speed_limits=np.ones(n), speed_scales=np.ones(n), joint_names=tuple(names),
    )  # fmt: skip
    at = (np.array([values[name] for name in names], float) for values in (start, goal))
    return Problem(cell, *at)


def ours(one: Problem, room: Feasible, seed: int) -> Floats | None:
    """Return the knots of the library's path."""
    if room.straight(one.start[None], one.goal[None], LEAST_MM)[0]:
        return np.stack([one.start, one.goal])
    detours = Detours(one.cell, room, np.zeros(len(one.start), bool), seed)
    ways = (
        detours.between(one.start, one.goal, LEAST_MM, effort, turning=False)
        for effort in range(len(SEARCHES))
    )
    return next((way for way in ways if way is not None), None)


def plain(one: Problem, check: CollisionCheck, seed: int, seconds: float) -> Floats | None:
    """Return the knots of a path by OMPL's RRT-Connect with its defaults."""
    base, geometric, util = _ompl()
    util.RNG.setSeed(seed + 1)
    n = len(one.start)
    space, bounds = base.RealVectorStateSpace(n), base.RealVectorBounds(n)
    for j, (low, high) in enumerate(one.cell.joint_ranges.tolist()):
        bounds.setLow(j, low)
        bounds.setHigh(j, high)
    space.setBounds(bounds)
    setup = geometric.SimpleSetup(space)
    setup.setStateValidityChecker(lambda state: check.clear(np.array([state[j] for j in range(n)])))
    information = setup.getSpaceInformation()
    information.setStateValidityCheckingResolution(SEARCHES[0][1] / space.getMaximumExtent())
    ends = []
    for joints in (one.start, one.goal):
        state = space.allocState()
        for j, q in enumerate(joints.tolist()):
            state[j] = q
        ends.append(state)
    setup.setStartAndGoalStates(*ends)
    setup.setPlanner(geometric.RRTConnect(information))
    setup.solve(seconds)
    if not setup.haveExactSolutionPath():
        return None
    setup.simplifySolution()
    states = setup.getSolutionPath().getStates()
    return np.array([[state[j] for j in range(n)] for state in states])


def collides(one: Problem, knots: Floats) -> bool:
    """Return True if coal finds a collision at steps of 1 mm along a path."""
    model, data = one.cell.model, mujoco.MjData(one.cell.model)
    judge, pairs = CoalDistances(model), one.cell.pairs
    for a, b in zip(knots[:-1], knots[1:], strict=True):
        way = np.abs(b - a) @ one.cell.lever.T  # bound on the way of each body
        for share in np.linspace(0, 1, max(2, int(np.ceil(way.max() / STEP_M)))):
            data.qpos[:] = a + share * (b - a)
            mujoco.mj_kinematics(model, data)
            if not judge.clear(data, pairs, 1e-9):
                return True
    return False


def length(knots: Floats) -> float:
    """Return the length of a path, rad."""
    return float(np.linalg.norm(np.diff(knots, axis=0), axis=1).sum())


def tried(one: Problem, seed: int, seconds: float, judged: bool) -> dict[str, Any]:
    """Return what both find for a problem; coal judges their paths if asked."""
    room, check = Feasible(one.cell, "both"), CollisionCheck(one.cell)
    check.keep(LEAST_MM)
    ends = np.stack([one.start, one.goal])
    found: dict[str, Any] = {"ends_clear": bool(room.clear(ends, LEAST_MM).all())}
    for name, work in (
        ("ours", lambda: ours(one, room, seed)),
        ("plain", lambda: plain(one, check, seed, seconds)),
    ):
        began = time.process_time()
        knots = work()
        found[f"{name}_s"] = time.process_time() - began
        found[name] = knots is not None
        if knots is not None:
            found[f"{name}_rad"] = length(knots)
            found[f"{name}_judged"] = judged
            found[f"{name}_collides"] = judged and collides(one, knots)
    return found


def summary(name: str, found: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the figures of some problems."""
    both = [one for one in found if one["ours"] and one["plain"]]
    told: dict[str, Any] = {
        "set": name,
        "problems": len(found),
        "ends_in_contact": sum(not one["ends_clear"] for one in found),
    }
    for who in ("ours", "plain"):
        told[f"{who}_solved"] = sum(one[who] for one in found)
        told[f"{who}_judged"] = sum(one.get(f"{who}_judged", False) for one in found)
        told[f"{who}_collide"] = sum(one.get(f"{who}_collides", False) for one in found)
    if both:
        told["ours_median_s"] = round(float(np.median([one["ours_s"] for one in both])), 3)
        told["plain_median_s"] = round(float(np.median([one["plain_s"] for one in both])), 3)
        ratios = [one["ours_s"] / one["plain_s"] for one in both]
        told["time_ratio_median"] = round(float(np.median(ratios)), 2)
        ratios = [one["ours_rad"] / one["plain_rad"] for one in both]
        told["length_ratio_median"] = round(float(np.median(ratios)), 3)
        told["length_ratio_mean"] = round(float(np.mean(ratios)), 3)
    return told


def sets(folder: Path, per_set: int, seed: int) -> Iterator[tuple[str, list[int]]]:
    """Yield each set with the numbers of its problems that are tried."""
    for path in sorted((folder / "problems").iterdir()):
        numbers = sorted(int(file.stem[-4:]) for file in path.glob("request*.yaml"))
        rng = random.Random(f"{path.name} {seed}")
        yield path.name, sorted(rng.sample(numbers, min(per_set, len(numbers))))


def main() -> None:
    """Try the problems, and print what was found."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--per-set", type=int, default=100)
    parser.add_argument("--seed", type=int, default=62)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--judged", type=int, help="problems of each set that coal judges")
    parser.add_argument("--only", nargs="*", help="names of sets")
    args = parser.parse_args()
    everything = []
    with tempfile.TemporaryDirectory() as scratch:
        for name in ("arms.tar.gz", *(f"{arm}.tar.bz2" for arm in ARMS)):
            with tarfile.open(args.folder / name) as packed:
                packed.extractall(scratch, filter="data")
        for name, numbers in sets(Path(scratch), args.per_set, args.seed):
            if args.only and name not in args.only:
                continue
            found = [
                tried(
                    problem(Path(scratch), name, number),
                    args.seed,
                    args.seconds,
                    args.judged is None or k < args.judged,
                )
                for k, number in enumerate(numbers)
            ]
            everything += found
            print(json.dumps(summary(name, found)), flush=True)
    print(json.dumps(summary("all", everything)))


if __name__ == "__main__":
    main()
