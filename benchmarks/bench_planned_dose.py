"""Dose to both eye lenses of planned views, at a detectability as the equidistant path has.

    python benchmarks/bench_planned_dose.py --out out/planned_dose [--seeds 2 3 4 5 6]
        [--ways "as it is" scouted] [--unscattered]

The head, equal photons for each view; the signal is a sphere of 2 mm radius in the right skull
base. The baseline is the paper's equidistant path at head rotations all round (the path is turned,
which is the same where nothing need be within reach): of those whose d' is within 5 % of the best,
the one with the least dose. Planned views are chosen among those that the arms of the default cell
can hold with free roll: most d' below a limit of the lenses' mean dose, the limit lowered by
bisection while the d' that the prior foresees stays above a share of the baseline's best by the
same prior that leaves room for what it gets wrong. A seed is a prior: the head moved by 2 mm and
turned by 2 degrees, each in a random direction; from it views are planned as it is, and registered
by six scout views from behind the head with a hundredth of the photons, noise drawn from the seed,
whose dose counts. Both are judged on the truth, predicted, with no noise drawn; all doses are
printed with scattered photons and without. ``--unscattered`` plans as if there were none.

Ends with 1 if d' of a seed is below 95 % of the baseline's best, or the mean dose is not 40 %
lower, in either way. Results are kept in the folder, a line a seed; a later call goes on.
"""

from __future__ import annotations

import argparse
import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from twinct.core.progress import SILENT
from twinct.geometry import Pose, ScanGeometry
from twinct.runs import acquire_to_store
from twinct.scan import SimulationBuilder, local_rig
from twinct.scenario import Scenario, load_scenario, parse_scenario
from twinct.trajectory import commanded_views, farthest_first, write_views
from twinct.view_planning import Goal, Mean, search_views
from twinct.view_plans.candidates import candidates_of, orbit_of, reachable
from twinct.view_plans.scout import scouted
from twinct.view_plans.task_goals import goals_of
from twinct.xray.build import build_beam
from twinct.xray.dose import PlaceDoses

HEAD = Path(__file__).parents[1] / "scenarios" / "head.yaml"
VIEWS, CANDIDATES, PHOTONS = 40, 400, 9e5
ROTATIONS_DEG = range(0, 360, 30)
KEYS = [
    "cell={kind: arms}",
    "motion={detector_roll: free, trigger: settled}",
    "detector={columns: 160, rows: 120, pixel_pitch_mm: 2.0}",
    f"source.photons_per_mm2_mas={PHOTONS}",
    f"trajectory.views={VIEWS}",
]
TASK: dict[str, Any] = {
    "position_mm": [36.8, -7.9, -6.5],
    "radius_mm": 0.0,
    "views": VIEWS,
    "candidates": CANDIDATES,
    "detectability": {"signal": {"kind": "sphere", "radius_mm": 2, "contrast_rel": 0.1}},
}
LENSES = ("right lens", "left lens")
KEPT = 0.95
AIMED = {"as it is": 1.0, "scouted": 0.97}
"""Share of the baseline's best d' that must be had, and that is planned for. The room between was
chosen with seed 1, which is not reported: a prior as it is promises up to 0.043 too much."""
HALVINGS, ROUNDS, LOWER = 6, 2, 0.6
SCOUTS, FROM_DEG = 6, 270.0
SCOUT_KEYS = ["cell={kind: gantry}", "motion={}", "detector.noise={kind: quantum}"]
SCOUT_MAS_REL = 0.01
DOSE_PHOTONS = 300_000
OFF_MM, OFF_DEG = 2.0, 2.0


def with_part(scenario: Scenario, part: str, **counts: Any) -> Scenario:
    """The scenario with a task that counts dose to a part."""
    told = scenario.model_dump(mode="json")
    told["task"] = TASK | {"dose": {"part": part, "photons": DOSE_PHOTONS}} | counts
    return parse_scenario(told)


def measures(
    scenario: Scenario, geometry: ScanGeometry, candidates: int, even: list[int]
) -> tuple[Goal, Goal, Goal]:
    """D', and the mean dose of both lenses, Gy, with scattered photons and without."""
    right, left = LENSES
    found = goals_of(
        SimulationBuilder(with_part(scenario, right)), geometry, candidates, even, SILENT
    )
    quick = {"detectability": None, "completeness": {"within_deg": 3.0}}
    other = goals_of(
        SimulationBuilder(with_part(scenario, left, **quick)), geometry, candidates, even, SILENT
    )
    doses = [goal.measure.each for goal in (found[1], other[1]) if isinstance(goal.measure, Mean)]
    assert len(doses) == len(LENSES)
    builder = SimulationBuilder(scenario)
    places = PlaceDoses(builder.specimen, build_beam(scenario.source), LENSES, 2.0, "voxel_mm")
    free = places.unscattered(geometry).mean(axis=1) * scenario.source.mas
    return (
        found[0],
        Goal("dose", Mean(np.mean(doses, axis=0)), 0.0),
        Goal("dose", Mean(free), 0.0),
    )


def prior(truth: Scenario, seed: int) -> Scenario:
    """What is planned from: the head lies elsewhere than it does."""
    shift, axis = np.random.default_rng([seed, 15]).normal(size=(2, 3))
    turn = Rotation.from_rotvec(np.radians(OFF_DEG) * axis / np.linalg.norm(axis))
    moved = np.array(truth.specimen.position_mm) + OFF_MM * shift / np.linalg.norm(shift)
    told = truth.model_dump(mode="json")
    assert not np.any(truth.specimen.rotation_deg), "the head must lie straight"
    told["specimen"] |= {
        "position_mm": moved.tolist(),
        "rotation_deg": turn.as_euler("xyz", degrees=True).tolist(),
    }
    return parse_scenario(told)


def scout_scan(seed: int, store: Path) -> ScanGeometry:
    """A few faint views of the head where it lies; the views."""
    keys = [
        *(*KEYS, *SCOUT_KEYS, f"seed={seed}", f"trajectory.views={SCOUTS}"),
        f"trajectory.centre_longitude_deg={FROM_DEG}",
        f"source.photons_per_mm2_mas={SCOUT_MAS_REL * PHOTONS}",
    ]
    builder = SimulationBuilder(load_scenario(HEAD, keys))
    acquire_to_store(builder, store, local_rig, resume=True)
    return builder.commanded


def best_baseline(paths: list[range], found: Goal, dose: Goal) -> tuple[int, float]:
    """Which of the paths has least dose of those within 5 % of the best d', and that d'."""
    told = [found.of(path) for path in paths]
    enough = [n for n, one in enumerate(told) if one >= KEPT * max(told)]
    return min(enough, key=lambda n: dose.of(paths[n])), max(told)


def plan(found: Goal, dose: Goal, candidates: int, aim: float, start: float) -> list[int]:
    """The views of the lowest limit of dose for which d' was reached."""
    assert isinstance(dose.measure, Mean)
    low, high = float(np.sort(dose.measure.each[:candidates])[:VIEWS].mean()), start
    best: list[int] = []
    for _ in range(HALVINGS):
        limit = (low + high) / 2
        goals = [found, Goal("dose", dose.measure, 0.0, at_most=limit)]
        views = list(search_views(goals, candidates, VIEWS, rounds=ROUNDS).chosen)
        print(f"  limit {limit:.3e} Gy: d' {found.of(views) / aim:.3f} of the target")
        if found.of(views) >= aim:
            best, high = views, limit
        else:
            low = limit
    if not best:
        raise SystemExit(f"no choice below {start:.3e} Gy has a d' of {aim:.3f}")
    return sorted(best)


def main() -> None:
    """All seeds, and their mean and spread."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, nargs="+", default=[2, 3, 4, 5, 6])
    parser.add_argument("--ways", nargs="+", choices=list(AIMED), default=list(AIMED))
    parser.add_argument("--unscattered", action="store_true", help="plan without scattered photons")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    truth = with_part(load_scenario(HEAD, KEYS), LENSES[0])
    orbit, task = orbit_of(truth.trajectory), truth.task
    assert task is not None
    everywhere, kept = (
        candidates_of(orbit, task.candidates, truth.detector.panel),
        options.out / "reachable.json",
    )
    if not kept.exists():
        kept.write_text(
            json.dumps(reachable(SimulationBuilder(truth), everywhere, SILENT).tolist())
        )
    within = everywhere[json.loads(kept.read_text())]
    count, even = len(within), farthest_first(within.source, VIEWS)
    print(f"{count} of {CANDIDATES} candidates within reach", flush=True)
    turned = [
        commanded_views(
            truth.trajectory.model_copy(update={"centre_longitude_deg": float(angle)}),
            truth.detector.panel,
        )
        for angle in ROTATIONS_DEG
    ]
    stores = {seed: options.out / f"scout_{seed}.zarr" for seed in options.seeds}
    scouts = [scout_scan(seed, store) for seed, store in stores.items()][0]
    together = ScanGeometry.joined([within, *turned, scouts])
    paths = [range(count + k * VIEWS, count + (k + 1) * VIEWS) for k in range(len(turned))]

    counted = 2 if options.unscattered else 1
    true_d, *true_doses = measures(truth, together, count, even)
    true_dose, without = true_doses
    for angle, path in zip(ROTATIONS_DEG, paths, strict=True):
        print(
            f"{angle} deg: d' {true_d.of(path):.3f}, {true_dose.of(path):.3e} Gy, "
            f"{without.of(path):.3e} Gy by unscattered photons",
            flush=True,
        )
    rotation, best = best_baseline(paths, true_d, true_doses[counted - 1])
    base_dose = true_dose.of(paths[rotation])
    scout_rel = SCOUT_MAS_REL * true_dose.of(range(len(together) - SCOUTS, len(together)))
    scout_rel *= SCOUTS / VIEWS / base_dose
    print(
        f"baseline: {ROTATIONS_DEG[rotation]} deg, d' {true_d.of(paths[rotation]) / best:.3f} of "
        f"the best {best:.3f}, {base_dose:.3e} Gy; spread evenly: d' {true_d.of(even) / best:.3f}, "
        f"dose {true_dose.of(even) / base_dose:.3f} of the baseline's; "
        f"scout views: {scout_rel:.4f}",
        flush=True,
    )
    log = options.out / ("seeds_unscattered.jsonl" if options.unscattered else "seeds.jsonl")
    lines = log.read_text().splitlines() if log.exists() else []
    known = {(one["way"], one["seed"]): one for one in map(json.loads, lines)}
    seeds: list[int] = options.seeds
    for way, seed in itertools.product(options.ways, seeds):
        if (way, seed) not in known:
            told = prior(truth, seed)
            if way == "scouted":
                seen = scouted(SimulationBuilder(told), stores[seed], SILENT)
                off = seen.world_from_specimen.inverse() @ truth.specimen.world_from_specimen
                left = float(np.linalg.norm(off.apply(TASK["position_mm"]) - TASK["position_mm"]))
                print(f"seed {seed}: {left:.2f} mm, {off.angle_deg(Pose.identity()):.2f} deg left")
                dumped = told.model_dump(mode="json")
                position, degrees = seen.world_from_specimen.to_euler()
                where = {"position_mm": position.tolist(), "rotation_deg": degrees.tolist()}
                told = parse_scenario(dumped | {"specimen": dumped["specimen"] | where})
            d, *doses = measures(told, together, count, even)
            dose = doses[counted - 1]
            foreseen, goal = best_baseline(paths, d, dose)
            views = plan(d, dose, count, AIMED[way] * goal, dose.of(paths[foreseen]))
            write_views(options.out / f"views_{way.replace(' ', '_')}_{seed}.csv", within[views])
            known[way, seed] = {
                "way": way,
                "seed": seed,
                "d_rel": true_d.of(views) / best,
                "dose_rel": true_dose.of(views) / base_dose + scout_rel * (way == "scouted"),
                "unscattered_rel": without.of(views) / without.of(paths[rotation]),
                "foreseen_d_rel": d.of(views) / goal,
            }
            with log.open("a") as stream:
                stream.write(json.dumps(known[way, seed]) + "\n")
        one = known[way, seed]
        print(
            f"{way}, seed {seed}: d' {one['d_rel']:.3f} of the best (predicted "
            f"{one['foreseen_d_rel']:.3f}), dose {one['dose_rel']:.3f} of the baseline's, "
            f"{one['unscattered_rel']:.3f} by unscattered photons",
            flush=True,
        )
    missed = False
    for way in options.ways:
        d_rel, dose_rel, free_rel = (
            np.array([known[way, seed][key] for seed in options.seeds])
            for key in ("d_rel", "dose_rel", "unscattered_rel")
        )
        print(
            f"{way}: dose {100 * (1 - dose_rel.mean()):.1f} +- {100 * dose_rel.std():.1f} % lower "
            f"({100 * (1 - free_rel.mean()):.1f} % by unscattered photons alone), "
            f"d' {d_rel.mean():.3f} (least {d_rel.min():.3f}) of the best, {len(d_rel)} priors"
        )
        missed = missed or d_rel.min() < KEPT or dose_rel.mean() > LOWER
    if missed:
        raise SystemExit("not reached: 40 % less dose at 95 % of d'")


if __name__ == "__main__":
    main()
