"""Order of views and configurations of the arms: how long does a stop-and-shoot scan move?

    python benchmarks/bench_order.py --out out/order [--cells upright] [--seeds 1 2 3 4 5]

Views are drawn at random from those that the arms of a cell can hold, of directions all over the
sphere, with ``motion.order: shortest`` and settled arms. Prints the duration of the plan, the
number of knots that its detours add, and the time of the search. To compare with other code, run it
once more with the ``src`` folder of that checkout in ``PYTHONPATH``: views within reach are kept in
the folder.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from twinct.core.progress import SILENT
from twinct.geometry.wire import targets_of
from twinct.robots.motion.path_search import find_joint_path
from twinct.robots.motion.plan import timed
from twinct.scan import SimulationBuilder
from twinct.scenario import load_scenario
from twinct.view_plans.candidates import candidates_of, orbit_of, reachable

SPHERE = {"parts": [{"shape": {"kind": "sphere", "radius_mm": 80, "mesh_resolution_mm": 8}}]}
FREE = {"detector_roll": "free", "trigger": "settled", "order": "shortest"}
FIXED = {"trigger": "settled", "order": "shortest"}
CELLS: dict[str, tuple[str, dict[str, Any], int]] = {
    "free roll": ("demo", {"motion": FREE}, 600),
    "fixed roll": ("demo", {"motion": FIXED}, 1200),
    "lbr": ("lbr_arc", {"motion": FREE, "specimen": SPHERE}, 1200),
    "operating room": ("operating_room", {"motion": FREE}, 600),
}
"""Built-in scenario, keys, and number of directions."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--cells", nargs="+", default=list(CELLS), choices=list(CELLS))
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3, 4, 5])
    parser.add_argument("--views", type=int, default=120)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for name in options.cells:
        base, changes, directions = CELLS[name]
        scenario = load_scenario(base, [f"{key}={json.dumps(of)}" for key, of in changes.items()])
        builder = SimulationBuilder(scenario)
        orbit, kept = orbit_of(scenario.trajectory), options.out / f"{name} {directions}.json"
        everywhere = candidates_of(orbit, directions, scenario.detector.panel)
        if not kept.exists():
            kept.write_text(json.dumps(reachable(builder, everywhere, SILENT).tolist()))
        within = json.loads(kept.read_text())
        for seed in options.seeds:
            drawn = np.random.default_rng([seed, 64]).permutation(within)[: options.views]
            started = time.perf_counter()
            way = find_joint_path(
                builder.cell,
                scenario.motion,
                targets_of(everywhere[np.sort(drawn).tolist()]),
                roll_free=builder.roll_free,
            )
            searched = time.perf_counter() - started
            plan = timed(builder.cell, scenario.motion, way)
            print(
                f"{name}, seed {seed}: {len(drawn)} of {len(within)} views, motion "
                f"{plan.duration_s:.1f} s, {len(way.joints) - len(drawn) - 1} knots of detours, "
                f"searched {searched:.1f} s",
                flush=True,
            )


if __name__ == "__main__":
    main()
