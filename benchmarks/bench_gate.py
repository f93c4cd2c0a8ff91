"""Cost of the gate that each motion passes in each cycle, as a share of a scan's motion.

    python benchmarks/bench_gate.py [--scenario scenarios/demo.yaml] [--pairs 12]

Moves the arms through all views with and without the gate, in turn. Other programs on the machine
only add time, so the shortest processor time of each view among all turns counts.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

from twinct.robots.motion import PursuingSimulation
from twinct.scan import SimulationBuilder
from twinct.scenario import load_scenario

ROOT = Path(__file__).parents[1]


class Ungated(PursuingSimulation):
    """Simulation whose cycles pass no gate."""

    def _step(self, state: np.ndarray) -> None:
        self._control(state)


def seconds(builder: SimulationBuilder, *, gated: bool) -> np.ndarray:
    """Return the processor time of the motion to each view."""
    robots, plan, times = builder.robots(), builder.plan, [time.process_time()]
    assert isinstance(robots, PursuingSimulation) and plan is not None
    if not gated:
        robots.__class__ = Ungated
    for view, target in enumerate(plan.targets):
        robots.move(view, target)
        times.append(time.process_time())
    return np.diff(times)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--scenario", type=Path, default=ROOT / "scenarios" / "demo.yaml")
    parser.add_argument("--pairs", type=int, default=24)
    args = parser.parse_args()
    builder = SimulationBuilder(load_scenario(args.scenario))
    took: dict[bool, list[np.ndarray]] = {True: [], False: []}
    for pair in range(args.pairs):
        for gated in (True, False) if pair % 2 else (False, True):
            took[gated].append(seconds(builder, gated=gated))
    with_gate, without = (float(np.min(took[gated], axis=0).sum()) for gated in (True, False))
    figures = {"pairs": args.pairs, "with_s": with_gate, "without_s": without}
    print(json.dumps(figures | {"ratio": with_gate / without}, indent=2))


if __name__ == "__main__":
    main()
