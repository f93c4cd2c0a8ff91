"""Judge what a robots node answered to a stranger's targets (benchmarks/drive_nodes.py).

    python benchmarks/judge_driven.py out/driven.jsonl [--search-s 300]

Arms and panel are looked at where a target was reached: all pairs of geoms by Coal, which shares no
code with MuJoCo, nothing left out. A referee says which targets can be held at all: all
configurations of both arms in closed form, turned about the beam every 5 degrees where that is
free, every pair of them. For what the node refused and the referee has, two trees grow from where
the arms were and from all those pairs until they meet or the time is over. Each verdict is a line
of JSON beside the answers; those there are not judged again.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))

from coal_distances import CoalDistances

from twinct.geometry import MM_PER_M, Floats
from twinct.robots.cell import CellModel
from twinct.robots.motion.branches import Branches
from twinct.robots.motion.feasible import Feasible
from twinct.robots.motion.path_search import required_gap_mm
from twinct.scan import SimulationBuilder
from twinct.scenario import Motion, load_scenario

ROLLS_DEG = np.arange(0.0, 360.0, 5.0)
GOALS = 400
"""Pairs of configurations that the search may end in, those nearest to where the arms were."""
STEP_RAD = 0.7
BEYOND_RAD = 1.5
"""How far beyond start and goals the search goes in each joint."""
ANSWER_S = 10.0


class Judge:
    """Of one cell, at one clearance."""

    def __init__(self, cell: CellModel, motion: Motion) -> None:
        self._cell, self._least_mm = cell, required_gap_mm(motion)
        self._data, self._distances = mujoco.MjData(cell.model), CoalDistances(cell.model)
        self._branches = [Branches(cell, arm, motion.ik) for arm in range(2)]
        self._alone = [Feasible(cell, "source"), Feasible(cell, "detector")]
        self._cross, self._both = Feasible(cell, "cross"), Feasible(cell)

    def gap_mm(self, joints: Floats) -> float:
        """The smallest distance of all pairs that are not adjacent."""
        self._data.qpos[:] = joints
        mujoco.mj_kinematics(self._cell.model, self._data)
        return MM_PER_M * self._distances.smallest(self._data, self._cell.pairs)

    def held(self, poses: list[list[float]], free: bool, near: Floats) -> Floats:
        """Pairs of configurations that hold both poses clear of everything, (m, n).

        The nearest first, each joint on the turn that is nearest.
        """
        of_arms = []
        for arm, (*place, x, y, z, w) in enumerate(poses):
            rolls = Rotation.from_euler("z", ROLLS_DEG[:, None] if free else [[0.0]], degrees=True)
            asked = np.tile(np.eye(4), (len(rolls), 1, 1))
            asked[:, :3, :3] = (Rotation.from_quat([x, y, z, w]) * rolls).as_matrix()
            asked[:, :3, 3] = MM_PER_M * np.array(place)
            found = self._branches[arm].of(asked).joints
            placed = np.zeros((len(found), len(near)))
            placed[:, self._cell.arm_joints[arm]] = found
            of_arms.append(placed[self._alone[arm].clear(placed, self._least_mm)])
        pairs = (of_arms[0][:, None] + of_arms[1]).reshape(-1, len(near))
        low, high = self._cell.joint_ranges.T
        turned = near + (pairs - near + np.pi) % (2 * np.pi) - np.pi
        pairs = np.where((turned >= low) & (turned <= high), turned, pairs)
        pairs = pairs[np.argsort(np.abs(pairs - near).max(axis=1), kind="stable")]
        found = []
        for start in range(0, len(pairs), 2000):
            part = pairs[start : start + 2000]
            found.extend(part[self._cross.clear(part, self._least_mm)])
            if len(found) >= GOALS:
                break
        return np.array(found[:GOALS]).reshape(-1, len(near))

    def connected(self, start: Floats, goals: Floats, seconds: float) -> bool:
        """Whether a way from start to any goal was found within so many seconds."""
        rng, begin = np.random.default_rng(0), time.monotonic()
        low, high = self._cell.joint_ranges.T
        every = np.vstack([start, goals])
        low = np.maximum(low, every.min(axis=0) - BEYOND_RAD)
        high = np.minimum(high, every.max(axis=0) + BEYOND_RAD)
        one, other = start[None], goals
        while time.monotonic() - begin < seconds:
            wanted = rng.uniform(low, high)
            new = self._step(one, wanted)
            if new is not None:
                one = np.vstack([one, new])
                while (next_ := self._step(other, one[-1])) is not None:
                    other = np.vstack([other, next_])
                    if np.array_equal(next_, one[-1]):
                        return True
            one, other = other, one
        return False

    def _step(self, tree: Floats, wanted: Floats) -> Floats | None:
        near = tree[np.linalg.norm(tree - wanted, axis=1).argmin()]
        way = wanted - near
        length = float(np.linalg.norm(way))
        new = wanted if length <= STEP_RAD else near + STEP_RAD / length * way
        if length == 0 or not self._both.straight(near[None], new[None], self._least_mm)[0]:
            return None
        return new

    def verdict(self, line: dict[str, Any], search_s: float) -> dict[str, Any]:
        told: dict[str, Any] = {"target": line["target"], "seconds": line["seconds"]}
        told["reached"] = "refused" not in line
        told["processor_s"] = line["processor_s"]
        if told["reached"]:
            off = np.subtract(line["executed"], line["poses"])[:, :3]
            told["off_mm"] = MM_PER_M * float(np.linalg.norm(off, axis=1).max())
            told["gap_mm"] = self.gap_mm(np.array(line["joints"]))
            told["least_mm"] = line["clearance_mm"]
        start = np.array(line["start"])
        goals = self.held(line["poses"], line["roll"] == "free", start)
        told["referee"] = len(goals) > 0
        told["connected"] = told["reached"] or (
            told["referee"] and self.connected(start, goals, search_s)
        )
        return told


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("answers", type=Path, nargs="?", default=Path("out/driven.jsonl"))
    parser.add_argument("--scenario", default="scenarios/demo.yaml")
    parser.add_argument("--search-s", type=float, default=300.0)
    args = parser.parse_args()
    if not args.answers.exists():
        raise SystemExit(f"{args.answers} does not exist: run benchmarks/drive_nodes.py first")
    scenario = load_scenario(args.scenario)
    judge = Judge(SimulationBuilder(scenario).cell, scenario.motion)
    lines = [json.loads(text) for text in args.answers.read_text().splitlines()]
    kept = args.answers.with_suffix(".judged.jsonl")
    done = [json.loads(text) for text in kept.read_text().splitlines()] if kept.exists() else []
    with kept.open("a") as stream:
        for line in lines[len(done) :]:
            done.append(judge.verdict(line, args.search_s))
            stream.write(json.dumps(done[-1]) + "\n")
            stream.flush()
    print(json.dumps(figures(done), indent=2))


def figures(verdicts: list[dict[str, Any]]) -> dict[str, Any]:
    reached = [v for v in verdicts if v["reached"]]
    due = [v for v in verdicts if v["referee"] and v["connected"]]
    missed = [v["target"] for v in due if not v["reached"] or v["seconds"] > ANSWER_S]
    told: dict[str, Any] = {
        "targets": len(verdicts),
        "held_by_referee": sum(v["referee"] for v in verdicts),
        "and_connected": len(due),
        "of_those_reached_in_time": 1 - len(missed) / len(due),
        "missed": missed,
        "answered_late": [v["target"] for v in verdicts if v["seconds"] > ANSWER_S],
        "reached_but_not_held": [v["target"] for v in reached if not v["referee"]],
        "smallest_gap_mm": min(v["gap_mm"] for v in reached),
        "smallest_gap_on_the_way_as_told_mm": min(v["least_mm"] for v in reached),
        "furthest_off_mm": max(v["off_mm"] for v in reached),
    }
    for name in ("reached", "refused"):
        for clock in ("seconds", "processor_s"):
            of = [v[clock] for v in verdicts if v["reached"] == (name == "reached")]
            told[f"{name}_{clock}_median_p95_max"] = np.percentile(of, [50, 95, 100]).tolist()
    return told


if __name__ == "__main__":
    main()
