"""Gap between the arms and the skin of a patient, over the executed views of a run.

    twinct run scenarios/patient_head.yaml --out out/head
    python benchmarks/bench_skin_gap.py out/head

Skin and plate are the convex bodies that hold them, without the safety distance that the plan
adds. Between two views, the joints move on a straight line.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from twinct.robots.cell.clearance import Clearance
from twinct.runs import load_scan
from twinct.scan import ScanStore, SimulationBuilder


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path, nargs="+", help="folder of a run")
    for folder in parser.parse_args().folder:
        scan = load_scan(folder)
        builder = SimulationBuilder(scan.scenario, ScanStore(folder / "scan.zarr").plan)
        room = builder.room
        specimen = [[room.body_of_geom(int(g)) == "specimen" for g in pair] for pair in room.pairs]
        beside = replace(room, pairs=room.pairs[np.any(specimen, axis=1)])
        gap = Clearance(beside).over(np.asarray(scan.joints))
        print(
            f"{folder.name}: {len(scan)} views; {len(builder.specimen.hulls)} convex bodies; "
            f"smallest gap {gap.distance_mm:.1f} mm, between {' and '.join(gap.bodies)}"
        )


if __name__ == "__main__":
    main()
