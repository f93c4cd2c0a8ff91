"""What an earlier volume is worth to few views: the head, 40 views, and something new in it.

    python benchmarks/bench_prior.py --out out/prior
    python benchmarks/bench_prior.py --out out/prior4 --factor 4

Scans scenarios/head.yaml with 320 x 240 pixels and quantum noise twice, into stores that a later
call goes on with: earlier with 200 views, the head turned by 1 degree and moved by 1 mm; and now
with 40 of the path's views and a lesion of 10 mm in the brain, +10 % of mu(bone). The earlier
scan's volume, by ``fast``, is the prior; it is kept, too. Both reconstructions of the 40 views get
the regularisation that suits them best, near bone, and that without a prior one round or four.
The lesion's contrast is the mean of its inner 6 mm less that of the brain 8 to 12 mm from its
middle, of the truth's.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

from twinct.evaluation import image_figures
from twinct.geometry import Pose
from twinct.recon.volume import Volume
from twinct.runs import acquire_to_store, reconstruct, truth_of
from twinct.scan import Scan, SimulationBuilder, local_rig
from twinct.scenario import Scenario, load_scenario, parse_scenario

HEAD = Path(__file__).parents[1] / "scenarios" / "head.yaml"
PLACE_MM = 0.0, -20.0, 32.0
"""Of the lesion's middle in the head."""
LESION = {
    "name": "lesion",
    "position_mm": PLACE_MM,
    # 10 % of mu(bone) more than the brain at 80 keV.
    "material": {"of": "brain", "density_g_cm3": 1.283},
    "shape": {"kind": "sphere", "radius_mm": 5.0, "mesh_resolution_mm": 0.5},
}
SURROUNDINGS = {"margin_mm": 50.0, "voxel_mm": 2.5, "iterations": 60}
"""Of the 40 views, which make one update each: more of it stays with fewer."""
MOVED_MM = 0.6, -0.5, 0.62
TURNED_DEG = 0.5, -0.6, 0.62
STRENGTHS = (2.5e-5, 5e-5, 1e-4, 2e-4)
SHARES = (0.9, 1.0)


def scenario(factor: int, views: int, photons: float, overrides: list[str]) -> dict[str, Any]:
    """The head's, in pixels and voxels that are larger by a factor."""
    keys = {
        "detector.columns": 320 // factor,
        "detector.rows": 240 // factor,
        "detector.pixel_pitch_mm": float(factor),
        "detector.noise": "{kind: quantum}",
        # So many on a pixel of 1 mm^2 at 600 mm, with the 0.01 mAs of a view.
        "source.photons_per_mm2_mas": photons * 36 / factor**2,
        "trajectory.views": views,
        "reconstruction.grid": f"{{voxels: {256 // factor}, voxel_mm: {0.62 * factor}}}",
    }
    told = [f"{key}={value}" for key, value in keys.items()]
    return load_scenario(HEAD, [*told, *overrides]).model_dump(mode="json")


def earlier(factor: int, photons: float, overrides: list[str]) -> Scenario:
    told = scenario(factor, 200, photons, overrides)
    stand = told["specimen"]["position_mm"]
    told["specimen"]["position_mm"] = [a + b for a, b in zip(stand, MOVED_MM, strict=True)]
    told["specimen"]["rotation_deg"] = TURNED_DEG
    return parse_scenario(told | {"seed": 101})


def now(factor: int, photons: float, overrides: list[str]) -> Scenario:
    told = scenario(factor, 40, photons, overrides)
    told["specimen"]["parts"].insert(-1, LESION)  # the skull wins where they overlap
    return parse_scenario(told | {"seed": 102})


def scanned(of: Scenario, folder: Path) -> Scan:
    store = acquire_to_store(SimulationBuilder(of), folder / "scan.zarr", local_rig, resume=True)
    return store.read().with_settings(of)  # reconstructed as it says now


class Judge:
    """The figures of the table for volumes of the scan with the lesion."""

    def __init__(self, scan: Scan) -> None:
        self.grid = scan.scenario.reconstruction.volume_grid
        self.truth = truth_of(scan, SimulationBuilder(scan.scenario))
        stands = scan.scenario.specimen.world_from_specimen
        x, y, z = self.grid.axes()
        cx, cy, cz = self.grid.world_from_grid.inverse().apply(stands.apply(PLACE_MM))
        away = np.sqrt((x - cx) ** 2 + ((y - cy) ** 2)[:, None] + ((z - cz) ** 2)[:, None, None])
        self.inner, self.around = away < 3, (away > 8) & (away < 12)
        if not (self.truth.region | ~(away < 12)).all():
            raise SystemExit("the lesion lies where not every view sees it")

    def contrast(self, volume: np.ndarray) -> float:
        return float(volume[self.inner].mean() - volume[self.around].mean())

    def __call__(self, volume: np.ndarray) -> dict[str, float]:
        truth, mu = self.truth, self.truth.mu_reference
        figures = image_figures(volume, truth.volume, truth.region, mu, self.grid)
        return {
            "near_bone": figures.rmse_near_rel,
            "region": figures.rmse_rel,
            "contrast": self.contrast(volume) / self.contrast(truth.volume),
        }


def words(figures: dict[str, float]) -> str:
    return (
        f"{100 * figures['near_bone']:.2f} % near bone, {100 * figures['region']:.2f} % in the "
        f"region, contrast {100 * figures['contrast']:.0f} %"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True, help="folder for scans and prior")
    parser.add_argument("--factor", type=int, default=1, help="factor to enlarge pixels and voxels")
    parser.add_argument("--photons", type=float, default=1e5, help="per pixel of 1 mm^2")
    parser.add_argument("--iterations", type=int, default=24)
    parser.add_argument("--strengths", type=float, nargs="+", default=STRENGTHS)
    parser.add_argument("--shares", type=float, nargs="+", default=SHARES)
    parser.add_argument("--set", action="append", default=[], help="other keys of the scenario")
    options = parser.parse_args()
    of = options.factor, options.photons, options.set
    before, scan = (
        scanned(make(*of), options.out / name)
        for name, make in (("earlier", earlier), ("now", now))
    )
    file = options.out / "prior.nii"
    if not file.exists():
        print("prior", flush=True)
        reconstruct(before, algorithm="fast", margin=0.0, surroundings=SURROUNDINGS).write(file)
    judge = Judge(scan)
    mu = judge.truth.mu_reference
    print(f"the lesion stands out by {100 * judge.contrast(judge.truth.volume) / mu:.1f} % of mu")
    kept = options.out / "found.json"
    found: dict[str, dict[str, float]] = json.loads(kept.read_text()) if kept.exists() else {}
    ways = [
        ("fast", 0.0),
        *(("prior_tv", share) for share in options.shares),
    ]
    for algorithm, share in ways:
        for strength in options.strengths:
            name = f"{algorithm} {share:g} {strength:g} {options.iterations}"
            if name not in found:
                keys: dict[str, Any] = {"passes": options.iterations, "strength": strength}
                if algorithm == "prior_tv":
                    keys = {
                        "iterations": options.iterations,
                        "rounds": 4,
                        "regularisation": strength,
                        "prior": {"path": str(file), "share": share},
                    }
                volume = reconstruct(
                    scan,
                    algorithm=algorithm,
                    surroundings=SURROUNDINGS,
                    **keys,
                )
                found[name] = judge(volume.array) | {"strength": strength}
                if "world_from_prior" in volume.extras:
                    found[name] |= misplaced(before, scan, volume)
                kept.write_text(json.dumps(found, indent=1))
            print(f"{name}: {words(found[name])}", flush=True)
    plain, ours = (
        min(
            (one for name, one in found.items() if name.startswith(algorithm)),
            key=lambda one: one["near_bone"],
        )
        for algorithm in ("fast", "prior_tv")
    )
    print(f"without a prior, regularisation {plain['strength']:g}: {words(plain)}")
    print(f"with it, regularisation {ours['strength']:g}: {words(ours)}")
    print(f"registered to {ours['away_mm']:.3f} mm and {ours['turned_deg']:.3f} deg")
    print(f"near bone {ours['near_bone'] / plain['near_bone']:.2f} x")


def misplaced(before: Scan, scan: Scan, volume: Volume) -> dict[str, float]:
    """How far the prior's place is from where it should be, at the head's middle."""
    there, here = (s.scenario.specimen.world_from_specimen for s in (before, scan))
    error = volume.extras["world_from_prior"] @ there @ here.inverse()
    return {
        "away_mm": float(np.linalg.norm(error.apply(here.position) - here.position)),
        "turned_deg": error.angle_deg(Pose.identity()),
    }


if __name__ == "__main__":
    main()
