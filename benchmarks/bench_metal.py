"""What metal costs a reconstruction, and what is left of it: the head with two titanium screws.

    python benchmarks/bench_metal.py --out out/metal

Scans scenarios/head_screws.yaml once as it is and once without the screws, into stores that a later
call goes on with; the noise of the two is not the same. Reconstructs from believed poses, all with
the scenario's correction of beam hardening and its surroundings taken out. The error is that of
bone and tissue between 2 and 15 mm from metal, where every view sees; each way has the iteration
that suits it best. The excess is sqrt(RMSE^2 - RMSE^2 without metal), of mu(bone), and 0 where the
error is not larger.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt

from twinct.observers import IterationDone, Observer
from twinct.runs import acquire_to_store, reconstruct, truth_of
from twinct.scan import Scan, Workshop, local_rig
from twinct.scenario import Scenario, load_scenario, parse_scenario

SCREWS = Path(__file__).parents[1] / "scenarios" / "head_screws.yaml"
NEAR_MM, FAR_MM = 2.0, 15.0
WAYS: Mapping[str, Mapping[str, Any] | None] = {"sart": None, "nmar": {"method": "nmar"}}


def scan(scenario: Scenario, folder: Path) -> Scan:
    return acquire_to_store(Workshop(scenario), folder / "scan.zarr", local_rig, resume=True).read()


def without_screws(scenario: Scenario) -> Scenario:
    told = scenario.model_dump(mode="json")
    parts = told["specimen"]["parts"]
    told["specimen"]["parts"] = [part for part in parts if part["material"] != "titanium"]
    return parse_scenario(told)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder for the two scans")
    parser.add_argument("--iterations", type=int, default=4)
    parser.add_argument("--set", action="append", default=[], help="other keys of the scenario")
    options = parser.parse_args()
    scenario = load_scenario(SCREWS, options.set)
    scans = {
        "with": scan(scenario, options.out / "with"),
        "without": scan(without_screws(scenario), options.out / "without"),
    }
    truth = truth_of(scans["with"], Workshop(scenario))
    plain = truth_of(scans["without"], Workshop(without_screws(scenario))).volume
    grid = scenario.reconstruction.grid.volume_grid
    away = distance_transform_edt(truth.volume <= 1.01 * plain.max(), sampling=grid.voxel[::-1])
    near = truth.region & (away > NEAR_MM) & (away < FAR_MM) & (plain > 0.3 * truth.mu_reference)
    print(f"{np.count_nonzero(near)} voxels of bone and tissue {NEAR_MM:g} to {FAR_MM:g} mm away")

    def best(which: str, metal: Mapping[str, Any] | None) -> float:
        """The smallest error of all iterations."""
        found: list[float] = []

        def judge(event: IterationDone) -> None:
            square = np.square(event.volume.array[near] - plain[near], dtype=np.float64)
            found.append(float(np.sqrt(square.mean())) / truth.mu_reference)

        observer = Observer(judge, wants=(IterationDone,), lossless=True)
        settings = {"iterations": options.iterations, "metal": metal}
        reconstruct(scans[which], algorithm="sart", observers=[observer], **settings)
        course = ", ".join(f"{100 * error:.2f}" for error in found)
        print(f"{which} metal, {metal or 'as it is'}: {course} % of mu(bone)", flush=True)
        return min(found)

    base = best("without", None)
    excess: dict[str, float] = {}
    for name, metal in WAYS.items():
        excess[name] = np.sqrt(max(best("with", metal) ** 2 - base**2, 0))
        share = excess[name] / (excess["sart"] or np.nan)
        print(f"{name}: excess {100 * excess[name]:.2f} %, {share:.2f} x sart's", flush=True)


if __name__ == "__main__":
    main()
