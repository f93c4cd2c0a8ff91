"""What metal costs a reconstruction, and what is left of it: the head with two titanium screws.

    python benchmarks/bench_metal.py --out out/metal [--seeds 1 2 3] [--ways sart nmar known]

Scans scenarios/head_screws.yaml once as it is and once without the screws, into stores that a later
call goes on with; the noise of the two is not the same. Reconstructs from believed poses, all with
the scenario's correction of beam hardening and its surroundings taken out. The error is that of
bone and tissue between 2 and 15 mm from metal, where every view sees, and between 1 and 2 mm; each
way has the iteration that suits it best. The excess is sqrt(RMSE^2 - RMSE^2 without metal), of
mu(bone), and 0 where the error is not larger.

The ways: ``sart`` and ``nmar`` as they are; ``known`` with the implants as they are; ``off``, that
is known with each 2 mm and 5 degrees away from where it is; with a wrong model ``alloy``
(Ti-6Al-4V), ``thick`` (2 % in diameter) and ``kvp`` (5 kV, for SART and without metal too).
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.spatial.transform import Rotation

from twinct.geometry import Pose
from twinct.observers import IterationDone, Observer
from twinct.runs import acquire_to_store, reconstruct, truth_of
from twinct.scan import Scan, SimulationBuilder, local_rig
from twinct.scenario import Scenario, load_scenario, parse_scenario

SCREWS = Path(__file__).parents[1] / "scenarios" / "head_screws.yaml"
SHELLS_MM = {"2 to 15 mm": (2.0, 15.0), "1 to 2 mm": (1.0, 2.0)}
OFF_MM, OFF_DEG, WRONG_KVP, THICK = 2.0, 5.0, 5.0, 1.02
WAYS = ("sart", "nmar", "known", "off", "alloy", "thick", "kvp")


def scan(scenario: Scenario, folder: Path) -> Scan:
    store = acquire_to_store(
        SimulationBuilder(scenario), folder / "scan.zarr", local_rig, resume=True
    )
    return store.read().with_settings(scenario)  # reconstructed as it says now


def without_screws(scenario: Scenario) -> Scenario:
    told = scenario.model_dump(mode="json")
    parts = told["specimen"]["parts"]
    told["specimen"]["parts"] = [part for part in parts if part["material"] != "titanium"]
    return parse_scenario(told)


def screws(scenario: Scenario) -> list[Any]:
    return [part for part in scenario.specimen.parts if part.material == "titanium"]


def away(
    part: Any, rng: np.random.Generator, off_mm: float = OFF_MM, off_deg: float = OFF_DEG
) -> dict[str, Any]:
    """A believed place that is off in a random direction, about an axis across the screw."""
    shift, turn = rng.normal(size=3), np.append(rng.normal(size=2), 0.0)
    twist = np.append(
        off_mm * shift / np.linalg.norm(shift), np.radians(off_deg) * turn / np.linalg.norm(turn)
    )
    pose = part.specimen_from_part
    turned = Rotation.from_quat(pose.quat) * Rotation.from_rotvec(twist[3:])
    rotation = turned.as_euler("xyz", degrees=True).tolist()
    return {"position_mm": (pose.position + twist[:3]).tolist(), "rotation_deg": rotation}


def metal_of(way: str, parts: list[Any], seed: int) -> Mapping[str, Any] | None:
    """The section ``reconstruction.metal`` of a way."""
    if way in ("sart", "nmar"):
        return {"method": "nmar"} if way == "nmar" else None
    rng = np.random.default_rng(seed)
    implants: list[dict[str, Any]] = [{"part": part.name} for part in parts]
    for told, part in zip(implants, parts, strict=True):
        if way == "off":
            told |= away(part, rng)
        if way == "alloy":
            told["material"] = "titanium_alloy"
        if way == "thick":
            shape = part.shape.model_dump()
            told["shape"] = shape | {"radius_mm": shape["radius_mm"] * THICK}
    return {"method": "known", "implants": implants}


def with_kvp(scan: Scan, more: float) -> Scan:
    """The scan as somebody sees it who believes in another voltage."""
    told = scan.scenario.model_dump(mode="json")
    told["source"]["spectrum"]["kvp"] += more
    return scan.with_settings(parse_scenario(told))


def pose_errors(found: list[Mapping[str, Any]], parts: list[Any]) -> str:
    """Of each screw, with its roll left aside."""
    errors: list[str] = []
    for one, part in zip(found, parts, strict=True):
        true, pose = (
            part.specimen_from_part,
            Pose.from_euler(one["position_mm"], one["rotation_deg"]),
        )
        between = np.arccos(np.clip(true.rotation[:, 2] @ pose.rotation[:, 2], -1, 1))
        errors.append(
            f"{pose.distance_mm(true):.3f} mm {np.degrees(between):.3f} deg (sigma "
            f"{np.linalg.norm(one['position_sigma_mm']):.3f} mm, density {one['density_rel']:.3f})"
        )
    return "; ".join(errors)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder for the scans")
    parser.add_argument("--iterations", type=int, default=4)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=WAYS)
    parser.add_argument("--set", action="append", default=[], help="other keys of the scenario")
    options = parser.parse_args()
    shares: dict[str, list[float]] = {}
    for seed in options.seeds:
        folder = options.out if seed == 1 else options.out / f"seed{seed}"
        scenario = load_scenario(SCREWS, [*options.set, f"seed={seed}"])
        for way, share in compare(scenario, folder, seed, options).items():
            shares.setdefault(way, []).append(share)
    for way, found in shares.items():
        each = ", ".join(f"{share:.2f}" for share in found)
        print(f"{way}: {np.mean(found):.2f} x sart's excess on average: {each}")


def compare(
    scenario: Scenario, folder: Path, seed: int, options: argparse.Namespace
) -> dict[str, float]:
    """Excess errors of all ways as shares of SART's."""
    plain_scenario, parts = without_screws(scenario), screws(scenario)
    scans = {
        "with": scan(scenario, folder / "with"),
        "without": scan(plain_scenario, folder / "without"),
    }
    grid = scenario.reconstruction.grid.volume_grid
    builders = {"with": SimulationBuilder(scenario), "without": SimulationBuilder(plain_scenario)}
    truth, bare = (truth_of(scans[which], builders[which]) for which in scans)
    gap = distance_transform_edt(
        truth.volume <= 1.01 * bare.volume.max(), sampling=grid.voxel[::-1]
    )
    seen = truth.region & (bare.volume > 0.3 * truth.mu_reference)
    shells = {name: seen & (gap > a) & (gap < b) for name, (a, b) in SHELLS_MM.items()}
    counts = ", ".join(f"{np.count_nonzero(s)} voxels {name} away" for name, s in shells.items())
    print(f"seed {seed}: {counts}")

    def best(which: str, way: str, more_kvp: float = 0.0) -> dict[str, float]:
        """The smallest error of all iterations, in each shell."""
        errors: dict[str, list[float]] = {name: [] for name in shells}
        given = with_kvp(scans[which], more_kvp)
        goal = bare
        if more_kvp:  # the same specimen at the energy that is believed
            goal = truth_of(with_kvp(scans["without"], more_kvp), builders["without"])

        def judge(event: IterationDone) -> None:
            for name, shell in shells.items():
                square = np.square(event.volume.array[shell] - goal.volume[shell], dtype=np.float64)
                errors[name].append(float(np.sqrt(square.mean())) / goal.mu_reference)

        observer = Observer(judge, wants=(IterationDone,), lossless=True)
        metal = metal_of(way, parts, seed)
        start = time.perf_counter()
        volume = reconstruct(
            given,
            algorithm="sart",
            observers=[observer],
            iterations=options.iterations,
            metal=metal,
        )
        for name, found in errors.items():
            course = ", ".join(f"{100 * error:.2f}" for error in found)
            print(f"  {which} metal, {way}, {name}: {course} % of mu(bone)")
        print(f"  {time.perf_counter() - start:.0f} s", flush=True)
        if "implants" in volume.extras:
            print(f"  {pose_errors(volume.extras['implants'], parts)}", flush=True)
        return {name: min(found) for name, found in errors.items()}

    base = {0.0: best("without", "sart")}
    full: dict[float, float] = {}
    shares: dict[str, float] = {}
    name = next(iter(shells))
    for way in options.ways:
        kvp = WRONG_KVP if way == "kvp" else 0.0
        if kvp not in base:
            base[kvp] = best("without", "sart", kvp)
        if kvp not in full:
            error = best("with", "sart", kvp)[name]
            full[kvp] = float(np.sqrt(max(error**2 - base[kvp][name] ** 2, 0))) or np.nan
        excess = full[kvp]
        if way != "sart":
            error = best("with", way, kvp)[name]
            excess = float(np.sqrt(max(error**2 - base[kvp][name] ** 2, 0)))
        shares[way] = excess / full[kvp]
        print(f"{way}: excess {100 * excess:.2f} %, {shares[way]:.2f} x sart's", flush=True)
    return shares


if __name__ == "__main__":
    main()
