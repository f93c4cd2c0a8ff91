"""Time of whole runs stated before them, against the runs.

python benchmarks/bench_estimate.py                          the six scenarios
python benchmarks/bench_estimate.py demo paper --processor   two of them, in processor seconds

All runs are over the local link, and no earlier small scans are known. Prints the stated and the
measured seconds of each stage, and the ratio of the whole. With ``--processor``, every clock counts
the processor seconds of all threads instead, which other programs on the machine hardly change; the
growth with the sizes, which is the model, is the same.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from twinct.runs import pilot
from twinct.scenario import load_scenario

SCENARIOS = {
    "demo": (),
    "paper": (
        "trajectory.views=60",
        "reconstruction.iterations=2",
        "reconstruction.grid.voxels=320",
    ),
    "patient_head": ("trajectory.views=60",),
    "operating_room": ("trajectory.views=40",),
    "circle_gantry": (),
    "head_screws": ("trajectory.views=60", "reconstruction.algorithm=fast"),
}
"""Keys that shorten the scans. ``paper`` keeps its pixels and voxels' size."""

PROCESSOR = "import time; time.perf_counter = time.process_time\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("scenarios", nargs="*", default=list(SCENARIOS))
    parser.add_argument("--processor", action="store_true", help="processor seconds of all threads")
    args = parser.parse_args()
    if args.processor:
        pilot.SCANS = PROCESSOR + pilot.SCANS
    for name in args.scenarios:
        with tempfile.TemporaryDirectory(prefix="twinct-estimate-") as folder:
            compare(name, Path(folder))


def compare(name: str, folder: Path) -> None:
    """State the time of a run, take it, and print both."""
    os.environ["XDG_CACHE_HOME"] = str(folder)
    scenario = load_scenario(name, list(SCENARIOS[name]))
    stated = pilot.measured_time(scenario, "local")
    if stated is None:
        raise SystemExit(f"{name}: no small scan can be taken")
    file = folder / "whole.yaml"
    file.write_text(scenario.model_dump_json(), encoding="utf-8")
    command = [sys.executable, "-P", "-c", pilot.SCANS, "local", str(folder), str(file)]
    said = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    taken = json.loads(next(line for line in said.stdout.splitlines() if line.startswith("{")))
    for stage, seconds in taken.items():
        print(f"    {stage:15} {stated.stages[stage]:8.1f} {seconds:8.1f} s")
    whole = sum(taken.values())
    load = " ".join(f"{one:.1f}" for one in os.getloadavg())
    ratio = f"{stated.whole / whole:.2f} x"
    print(
        f"{name}: stated {stated.whole:.0f}, taken {whole:.0f} s, {ratio} (load {load})",
        flush=True,
    )


if __name__ == "__main__":
    main()
