"""What the three processes of a long scan over ROS 2 hold: memory, descriptors, shared memory.

python benchmarks/bench_long_scan.py
python benchmarks/bench_long_scan.py --engines real --views 400

2,000 views of 32 x 24 px into a store, taken by the tiny engines of the graph's tests, or by MuJoCo
and gVXR; looked at every 100 views: proportional set size (PSS) and descriptors of each process,
and the shared memory that they have mapped. Growth is counted from view 200 on.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from twinct.link import RosRig
from twinct.link.rig import NODE_COMMAND
from twinct.runs import acquire_to_store
from twinct.scan import Rig, SimulationBuilder
from twinct.scenario import load_scenario

ROOT = Path(__file__).parents[1]
FAKE_COMMAND = (sys.executable, str(ROOT / "tests" / "ros" / "fake_node.py"))
KEYS = [
    *("detector.columns=32", "detector.rows=24", "detector.pixel_pitch_mm=10"),
    "specimen.parts=[{name: ball, shape: {kind: sphere, radius_mm: 60}, material: bone}]",
]
EVERY, SETTLED = 100, 200
NAMES = ("scan", "robots", "xray")


def pss_mb(pid: int) -> float:
    """Proportional set size of a process."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("Pss:")) / 1024


def descriptors(pid: int) -> int:
    """How many a process has open."""
    return len(os.listdir(f"/proc/{pid}/fd"))


def shared_mb(pids: list[int]) -> float:
    """Sizes of the files in /dev/shm that the processes have mapped."""
    files = {
        line.split()[-1]
        for pid in pids
        for line in Path(f"/proc/{pid}/maps").read_text().splitlines()
        if "/dev/shm/" in line and "(deleted)" not in line
    }
    return sum(Path(file).stat().st_size for file in files) / 2**20


def main() -> None:
    """Take the views and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--views", type=int, default=2000)
    parser.add_argument("--engines", choices=("tiny", "real"), default="tiny")
    options = parser.parse_args()
    real = options.engines == "real"
    base = "circle_gantry.yaml" if real else "demo.yaml"
    keys = [*KEYS, f"trajectory.views={options.views}"]
    scenario = load_scenario(ROOT / "scenarios" / base, keys)
    rows: list[tuple[float, ...]] = []

    def rigs(builder: SimulationBuilder, first: int, state: Any) -> Rig:
        command = NODE_COMMAND if real else FAKE_COMMAND
        plan = builder.plan if real else None
        rig = RosRig(scenario, plan=plan, first_view=first, start_state=state, node_command=command)
        pids = [os.getpid(), *(node.pid for node in rig._nodes)]
        move = rig.move

        def looked_at(view: int, target: Any) -> Any:
            if view and view % EVERY == 0 or view == options.views - 1:
                row = [*map(pss_mb, pids), *map(descriptors, pids), shared_mb(pids)]
                rows.append((view, *row))
                sys.stdout.write(line(rows[-1]) + "\n")
                sys.stdout.flush()
            return move(view, target)

        rig.move = looked_at
        return rig

    heads = [f"PSS {name}" for name in NAMES] + [f"fds {name}" for name in NAMES]
    sys.stdout.write("view   " + "  ".join(f"{head:>10}" for head in (*heads, "shm MB")) + "\n")
    with tempfile.TemporaryDirectory() as folder:
        acquire_to_store(
            SimulationBuilder(scenario), Path(folder) / "scan.zarr", rigs, resume=False
        )
    settled = np.array([row for row in rows if row[0] >= SETTLED])
    grown = settled[-1, 1:] - settled[0, 1:]
    sys.stdout.write(line((float("nan"), *grown)) + f"   grown from view {SETTLED} on\n")


def line(row: tuple[float, ...]) -> str:
    """A row of the table; MB and numbers."""
    return f"{row[0]:5.0f}  " + "  ".join(f"{value:10.1f}" for value in row[1:])


if __name__ == "__main__":
    main()
