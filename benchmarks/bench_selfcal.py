"""What errors of the geometry cost near bone, and how much of it the scan itself wins back.

    python benchmarks/bench_selfcal.py [--errors white smooth nod] [--seeds 1 2 3] [--out DIR]

The built-in skull on the paper's path, 200 views of 320 x 240, a grid of 256^3 voxels of 0.8 mm
that holds the whole skull; no noise. White and smooth: 0.5 mm and 0.2 deg along and about each
axis, source and panel independent, smooth ones alike over 40 views. Nod: the patient moves by 3 mm
and 2 deg and back over the scan, and jerks once by 1 mm and 1 deg.

Three volumes are made by SART: from the executed geometry, from the believed one and from the one
that was found, the latter two moved as a whole to where the executed lies; each counts at its best
iteration, by the RMSE within 3 mm of bone. Won back is the share of what the believed geometry
costs. One JSON line a case in DIR; those that are there are not done again. ``--factor 2``: pixels
and voxels twice as large, an eighth of the time. ``--real``: the skull of ``make paper``, which
tools/fetch-cranium fetches. ``--photons N``: in each pixel without a specimen, with their noise.
``--prior-off F``: the calibration believes in errors F times as large as they are. ``--as-found``:
geometries are judged where they lie, without the move to the executed one. ``--zoo NAME``: a scan
of the zoo (``zoo_scans``), with its own views and noise, judged near its object.
"""

from __future__ import annotations

import argparse
import json
import pickle
import time
from pathlib import Path

import numpy as np
from zoo_scans import HELD_OUT, TUNING, Made

from twinct.calibration import PosePrior, Round, aligned, moved, self_calibrated
from twinct.evaluation import image_figures, region_of_interest
from twinct.geometry import Pose, ScanGeometry
from twinct.recon import Projector, sart
from twinct.recon.few_photons import integrals_of_photons
from twinct.runs import simulate
from twinct.scan import SimulationBuilder, line_integrals
from twinct.scenario import Scenario, load_scenario, parse_scenario
from twinct.uncertainty.correlation import view_normals
from twinct.xray.build import effective_energy_kev

CRANIUM = Path(__file__).parents[1] / "scenarios" / "paper_cranium.yaml"
VIEWS, ALIKE = 200, 40.0
SIGMA_MM, SIGMA_DEG = 0.5, 0.2
SIGMA = np.array([SIGMA_MM] * 6 + [np.radians(SIGMA_DEG)] * 3)
MOST_PASSES = 12


def scenario_of(factor: int, real: bool = False) -> Scenario:
    """The scan of all cases."""
    part = {"shape": {"kind": "skull"}, "material": "bone"}
    if real:
        told = load_scenario(CRANIUM).specimen.parts[0].model_dump(mode="json")
        part = {key: told[key] for key in ("shape", "material")}
    return parse_scenario(
        {
            "cell": {"kind": "gantry"},
            "trajectory": {"kind": "sinusoid", "views": VIEWS},
            "detector": {
                "columns": 320 // factor,
                "rows": 240 // factor,
                "pixel_pitch_mm": 1.0 * factor,
            },
            "specimen": {"parts": [part]},
            "reconstruction": {"grid": {"voxels": 256 // factor, "voxel_mm": 0.8 * factor}},
        }
    )


def scanned(scenario: Scenario, kept: Path):
    """Line integrals, executed geometry, truth and its mu, region; made once."""
    if kept.exists():
        return pickle.loads(kept.read_bytes())
    builder = SimulationBuilder(scenario)
    scan = simulate(scenario, builder=builder)
    executed = scan.executed.geometry(scenario.detector.panel)
    grid = scenario.reconstruction.volume_grid
    energy = effective_energy_kev(scenario.source, scenario.detector)
    truth = builder.specimen.truth(grid, energy, scan.stands)
    told = (
        line_integrals(scan.transmission),
        executed,
        truth,
        builder.specimen.reference_mu(energy),
        region_of_interest(executed, grid),
    )
    kept.write_bytes(pickle.dumps(told))
    return told


def believed_of(executed: ScanGeometry, errors: str, seed: int) -> ScanGeometry:
    """What is believed where the executed is off by errors of a kind."""
    if errors == "nod":
        share = np.linspace(0, 1, len(executed))
        rng = np.random.default_rng([seed, 14])
        towards = rng.normal(size=(4, 3))
        towards /= np.linalg.norm(towards, axis=1)[:, None]
        nod = np.sin(np.pi * share)[:, None]
        jerk = (share > rng.uniform(0.3, 0.7))[:, None]
        sizes = 3.0, np.radians(2.0), 1.0, np.radians(1.0)
        way, turn = (
            size * nod * a + small * jerk * b
            for size, small, a, b in (
                (sizes[0], sizes[2], towards[0], towards[2]),
                (sizes[1], sizes[3], towards[1], towards[3]),
            )
        )
        moves = [Pose.exp(one) for one in np.concatenate([way, turn], axis=1)]
        return ScanGeometry.joined(
            [move @ view for move, view in zip(moves, executed, strict=True)]
        )
    length = ALIKE if errors == "smooth" else 0.0
    normals = [view_normals(seed, "selfcal", view, 9, length) for view in range(len(executed))]
    return moved(executed, SIGMA * np.array(normals))


def best(geometry, p, error_of, grid) -> tuple[float, int]:
    """Lowest error of SART's passes, and which that is."""
    found: list[float] = []

    def judge(step) -> bool:
        if (step.update + 1) % len(geometry) == 0:
            found.append(error_of(step.volume))
        return len(found) > 1 and found[-1] > found[-2]

    sart(
        Projector(geometry, grid),
        p,
        iterations=MOST_PASSES,
        relaxation=0.3,
        nonnegative=True,
        callback=judge,
    )
    return min(found), int(np.argmin(found)) + 1


def of_zoo(name: str, options):
    """Line integrals, executed geometry, grid and error of a scan of the zoo, with its noise."""
    made = Made(next(case for case in (*TUNING, *HELD_OUT) if case.name == name), options.seeds[0])
    return made.p, made.geometry, made.grid, lambda volume: made.error(volume) / 100


def of_skull(options):
    """The same of the skull."""
    scenario = scenario_of(options.factor, options.real)
    name = f"{options.factor}{'_real' if options.real else ''}"
    p, executed, truth, mu, region = scanned(scenario, options.out / f"scan{name}.pkl")
    if options.photons:
        counts = np.random.default_rng(14).poisson(options.photons * np.exp(-p, dtype=np.float64))
        p = integrals_of_photons(np.maximum(counts, 0.5) / options.photons, options.photons)
    grid = scenario.reconstruction.volume_grid
    return (
        p,
        executed,
        grid,
        lambda volume: image_figures(volume, truth, region, mu, grid).rmse_near_rel,
    )


def prior_of(errors: str, off: float) -> PosePrior:
    """The prior of a kind of errors, wrong by a factor."""
    if errors == "nod":
        return PosePrior(3.0 * off, 2.0 * off, 15.0)
    return PosePrior(SIGMA_MM * off, SIGMA_DEG * off, ALIKE if errors == "smooth" else 0.0)


def calibrated(errors: str, seed: int, scan, clean: float, options) -> dict:
    """One case: the errors of the believed and the found geometry."""
    p, executed, grid, error_of = scan
    points = grid.world_from_grid.apply(
        grid.size_mm.min() * 0.15 * np.array([[0, 0, 0], *np.eye(3), [-1, -1, -1]])
    )
    believed, prior = believed_of(executed, errors, seed), prior_of(errors, options.prior_off)
    start = time.process_time()
    what = "patient" if errors == "nod" else "arms"
    rounds = [Round(one) for one in options.rounds] if options.rounds else None
    found = self_calibrated(p, believed, grid, prior, what=what, rounds=rounds)
    case: dict = {"errors": errors, "seed": seed, "seconds": round(time.process_time() - start)}
    for name, geometry in (("believed", believed), ("found", found.geometry)):
        there = aligned(geometry, executed, points)
        judged = geometry if options.as_found else there.geometry
        case[name], case[f"{name} pass"] = best(judged, p, error_of, grid)
        case[f"{name} px"] = round(there.after_px, 4)
        case[f"{name} scale"] = round(there.scale, 6)
    case["won back"] = (case["believed"] - case["found"]) / (case["believed"] - clean)
    return case


def main() -> None:
    """Each case that is not there yet."""
    parser = argparse.ArgumentParser(description=__doc__)
    kinds = ("white", "smooth", "nod")
    parser.add_argument("--errors", nargs="+", choices=kinds, default=kinds)
    parser.add_argument("--seeds", nargs="+", type=int, default=(1, 2, 3))
    parser.add_argument("--factor", type=int, default=1)
    parser.add_argument("--real", action="store_true")
    parser.add_argument("--zoo")
    parser.add_argument("--photons", type=float)
    parser.add_argument("--prior-off", type=float, default=1.0)
    parser.add_argument("--as-found", action="store_true")
    parser.add_argument("--rounds", nargs="+", type=int, help="binning factors of the rounds")
    parser.add_argument("--out", type=Path, default=Path("out/selfcal"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    scan = of_zoo(options.zoo, options) if options.zoo else of_skull(options)
    kind = [options.zoo or options.factor, "real" * options.real, options.photons]
    name = "_".join(f"{one}" for one in kind if one)
    lines = options.out / f"cases{name}.jsonl"
    told = [json.loads(line) for line in lines.read_text().splitlines()] if lines.exists() else []
    way = {"prior_off": options.prior_off, "as_found": options.as_found}
    clean = next((one["executed"] for one in told if one["errors"] == "none"), None)

    def keep(case: dict) -> None:
        told.append(case)
        with lines.open("a") as stream:
            stream.write(json.dumps(case) + "\n")
        print(json.dumps(case), flush=True)

    if clean is None:
        p, executed, grid, error_of = scan
        clean, at = best(executed, p, error_of, grid)
        keep({"errors": "none", "seed": 0, "executed": clean, "pass": at})
    for errors in options.errors:
        for seed in options.seeds:
            key = {"errors": errors, "seed": seed} | way
            if not any(key.items() <= one.items() for one in told):
                keep(calibrated(errors, seed, scan, clean, options) | way)


if __name__ == "__main__":
    main()
