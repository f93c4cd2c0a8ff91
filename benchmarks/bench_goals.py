"""Random joint trajectories, the joints that they move unnamed, and steps above the limits.

    python benchmarks/bench_goals.py [--goals 2000] [--seed 1] [--kind after|over]

Goals are lines, cubics and quintics of some of the joints. ``after``: legal ones follow one another
between exposures and cancels, while the scan's own plan waits. ``over``: each comes while the arms
follow the one before, and begins at once, later, or began before; some are cancelled. Those that
the arms cannot go over to are refused, and the one before goes on. Ends with 1 if a joint that no
goal names moves by more than 0.01 deg, or a step exceeds a limit. The judges,
``tests/support/goals.py`` and ``overlaps.py``, share no code with twinct's gate.
"""

from __future__ import annotations

import argparse
import json
import random
import sys
from pathlib import Path

from twinct.core.errors import MotionError
from twinct.robots.cell import CellModel
from twinct.robots.motion import MotionPlan, PursuingSimulation
from twinct.scan import SimulationBuilder
from twinct.scenario import load_scenario

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests" / "support"))
from goals import MOVED_DEG, Chain, Goals  # noqa: E402
from overlaps import Overlaps  # noqa: E402

SLOW = ("motion.tool_speed_mm_s=40",)
"""A scan whose plan lasts longer than the goals of a chain, so that it might go on."""


def main() -> int:
    """Let chains of goals move the arms, and print what moved."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--goals", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", choices=("after", "over"), default="after")
    args = parser.parse_args()
    scenario = load_scenario(ROOT / "scenarios" / "demo.yaml", SLOW)
    builder = SimulationBuilder(scenario)
    robots, plan = builder.robots(), builder.plan
    assert isinstance(robots, PursuingSimulation) and plan is not None
    goals = Goals(builder.cell, scenario.motion.acceleration_deg_s2)
    if args.kind == "over":
        return overlapping(args.goals, args.seed, robots, plan, goals, builder.cell)
    followed, chains, failures, moved, trembled = 0, 0, [], 0.0, 0.0
    while followed < args.goals:
        rng, chains = random.Random(f"goals {args.seed} {chains}"), chains + 1
        robots.follow(plan)
        chain = Chain(robots, goals)
        try:
            for _ in range(rng.randint(1, 3)):
                if (act := rng.choice(("goal", "goal", "cancel", "expose"))) == "expose":
                    chain.expose()
                else:
                    chain.follow(rng, cancel=act == "cancel")
            chain.follow(rng)
            chain.end()
        except AssertionError as error:
            failures.append(f"chain {chains}: {error}")
        followed += chain.followed
        moved, trembled = max(moved, chain.moved_deg), max(trembled, chain.trembled_deg)
    answer = {"goals": followed, "chains": chains, "failures": failures, "allowed_deg": MOVED_DEG}
    print(json.dumps(answer | {"moved_deg": moved, "trembled_deg": trembled}, indent=2))
    return 1 if failures else 0


def overlapping(
    count: int,
    seed: int,
    robots: PursuingSimulation,
    plan: MotionPlan,
    goals: Goals,
    cell: CellModel,
) -> int:
    """Let goals replace each other, and print what was wrong."""
    overlaps, chains = Overlaps(robots, goals, cell), 0
    stopped, wrong = list[str](), list[str]()
    while overlaps.taken < count:
        rng, chains = random.Random(f"overlaps {seed} {chains}"), chains + 1
        robots.follow(plan)
        try:
            overlaps.play(rng, rng.randint(2, 6))
        except MotionError as error:  # a goal from the move may lead into a body
            stopped.append(f"chain {chains}: {error}")
        overlaps.wrong, found = [], overlaps.wrong
        wrong += [f"chain {chains}: {what}" for what in found]
    answer = {"goals": overlaps.taken, "refused": overlaps.refused, "chains": chains}
    answer |= {"stopped": stopped, "wrong": len(wrong), "first": wrong[:10]}
    print(json.dumps(answer | {"trembled_deg": overlaps.trembled_deg}, indent=2))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
