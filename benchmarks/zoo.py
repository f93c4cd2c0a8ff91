"""Errors of the algorithms on objects that are no skulls, against the best that SART and CGLS give.

python benchmarks/zoo.py --out out/zoo
python benchmarks/zoo.py --out out/zoo --held-out --seeds 5
python benchmarks/zoo.py --out out/zoo --cases foam wires --size 128 --seeds 1

Errors are RMSE within 3 mm of the object, without metal, in % of the mu of the densest material
that is no metal (``zoo_scans``). "Best pass" is chosen by the truth, which no user has: the least
error of 20 passes with relaxations of 0.1, 0.3 and 1. A relaxation ends early once its error is
10 % above its least. Baselines are non-negative, and have the surroundings removed where the object
reaches beyond the grid. "Denoised" has its total variation lowered, with the best of five
strengths, again chosen by the truth. ``auto`` is ``sart`` with relaxation 0.3 and ``stop: auto``.
``doubts`` says where a run warns that the volume of ``fast`` does not explain its projections.

Each figure is a line of OUT/zoo.jsonl; what is there is not computed again. ``--again fast auto``
drops the figures of these algorithms first. Small grids are faster with TWINCT_THREADS=1.
"""

import argparse
import json
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np
from denoised import lowered
from zoo_scans import HELD_OUT, NEAR_MM, SPAN_MM, THIN, TUNING, Made

from twinct.core.threads import let_idle_threads_sleep
from twinct.recon import cgls, fast, sart, without_surroundings
from twinct.recon.signs_beyond import signs_beyond
from twinct.recon.unexplained import compared_views, unexplained
from twinct.runs.model_doubts import MUCH_BESIDE, UNEQUAL, leaves_much

PASSES, RELAXATIONS = 20, (0.1, 0.3, 1.0)
DENOISED = (1, 2, 3, 4, 6, 8, 12, 16, 20)
STRENGTHS = (0.01, 0.03, 0.06, 0.12, 0.25)
"""Strengths of the baseline's denoising, in voxel edges times mu."""
ENOUGH = 1.1
AUTO = 0.3
MARGIN_MM, COARSE_MM = 60.0, 2.0


def without_rest(made, p=None):
    """Return the line integrals of the grid alone."""
    p = made.p if p is None else p
    return without_surroundings(made.A, p, margin_mm=MARGIN_MM, voxel_mm=COARSE_MM)


def passes_of(made, p, relaxation, *, nonnegative, watch=lambda number, x: None):
    """Return the error after each pass of SART, until it is well above its least, and seconds."""
    errors, spent = [], []
    clock = [time.process_time()]

    def judged(step):
        if step.update + 1 < step.updates:
            return False
        spent.append(time.process_time() - clock[0])
        errors.append(made.error(step.volume))
        watch(len(errors), step.volume)
        clock[0] = time.process_time() - spent[-1]
        return errors[-1] > ENOUGH * min(errors)

    keys = {"relaxation": relaxation, "nonnegative": nonnegative, "callback": judged}
    sart(made.A, p, iterations=PASSES, **keys)
    return errors, spent


def baselines(made):
    """Return the best passes of SART and CGLS."""
    found, p = {}, without_rest(made) if made.case.truncated else made.p
    at_auto, best, least = None, [], {"sart": np.inf, "cgls": np.inf}

    def denoised(number, x, of="sart"):
        if number in DENOISED:
            for strength in STRENGTHS:
                size = strength * made.mu * float(made.grid.voxel.mean()) ** 2
                least[of] = min(least[of], made.error(lowered(made.A, x, size)))

    for relaxation in RELAXATIONS:
        errors, spent = passes_of(made, p, relaxation, nonnegative=True, watch=denoised)
        if relaxation == AUTO:
            at_auto = min(errors)
        enough = next(k for k, e in enumerate(errors) if e <= 1.01 * min(errors))
        best.append((min(errors), relaxation, enough + 1, spent[enough]))
    error, relaxation, number, seconds = min(best)
    found["sart"] = {"error": error, "of": relaxation, "passes": number, "seconds": seconds}
    found["sart, denoised"] = {"error": least["sart"]}
    found["sart at 0.3"] = {"error": at_auto}
    signed, _ = passes_of(made, made.p, AUTO, nonnegative=False)
    found["sart, signed"] = {"error": min(signed)}
    steps = []

    def judged(step):
        volume = np.maximum(step.volume, 0)
        steps.append(made.error(volume))
        denoised(len(steps), volume, "cgls")

    cgls(made.A, p, iterations=PASSES, callback=judged)
    found["cgls"] = {"error": min(steps)}
    found["cgls, denoised"] = {"error": least["cgls"]}
    return found


def arguments(made):
    """Return whether a run warns that the object reaches beyond the grid, and then its cure."""
    signs = signs_beyond(made.A, made.p)
    warned = signs.beside > MUCH_BESIDE or signs.ratio > UNEQUAL
    keys = {"photons": made.case.photons, "margin": 0.0 if warned else None}
    return warned, without_rest(made) if warned else made.p, keys


def of_fast(made):
    """Return the error of ``fast`` with its defaults, its seconds, and whether a run warns."""
    warned, p, keys = arguments(made)
    start = time.process_time()
    volume = fast(made.A, p, **keys)
    seconds = time.process_time() - start
    found = {"error": made.error(volume.array), "seconds": seconds, "warned": bool(warned)}
    return {"fast": found | volume.extras["regularisation"]}


def of_doubts(made):
    """Return how much of the line integrals ``fast`` leaves, and whether a run warns of it."""
    _, p, keys = arguments(made)
    views = compared_views(len(made.A))
    volume = fast(made.A, p, predicted_views=views, **keys)
    photons = np.full(len(made.A), np.inf if made.case.photons is None else made.case.photons)
    seen = np.exp(-made.raw).astype(np.float32), None, photons
    rest = unexplained(made.A, p, volume.array, *seen, volume.extras["predicted"])
    assert rest is not None  # the photons are stated
    told = {"error": made.error(volume.array), "warned": leaves_much(rest)}
    return {"doubts": told | asdict(rest)}


def of_auto(made):
    """Return the error where ``stop: auto`` ends."""
    keys = {"iterations": PASSES, "relaxation": AUTO, "nonnegative": True, "stop": "auto"}
    p = without_rest(made) if made.case.truncated else made.p
    volume = sart(made.A, p, photons=made.case.photons, **keys)
    return {"auto": {"error": made.error(volume.array), "passes": volume.extras["passes"]}}


WAYS = {"baselines": baselines, "fast": of_fast, "auto": of_auto, "doubts": of_doubts}
COLUMNS = ("sart, signed", "sart", "sart, denoised", "cgls", "cgls, denoised", "fast", "auto")


class Lines:
    """Figures found so far, by (case, size, seed, algorithm)."""

    def __init__(self, path, again):
        """Read a file; drop the figures of some algorithms."""
        self.path, self.found = path, {}
        for text in path.read_text().splitlines() if path.exists() else ():
            line = json.loads(text)
            if line["way"] not in again:
                self.found[line["case"], line["size"], line["seed"], line["way"]] = line["found"]
        path.write_text("")
        for key, found in self.found.items():
            self._write(key, found)

    def add(self, key, found):
        """Keep the figures of an algorithm."""
        self.found[key] = found
        self._write(key, found)

    def _write(self, key, found):
        case, size, seed, way = key
        told = {"case": case, "size": size, "seed": seed, "way": way, "found": found}
        with self.path.open("a") as stream:
            stream.write(json.dumps(told) + "\n")


def measure(case, seed, size, ways, lines):
    """Compute the figures that are missing."""
    size = size or case.size
    missing = [way for way in ways if (case.name, size, seed, way) not in lines.found]
    if missing:
        made = Made(case, seed, size)
        for way in missing:
            lines.add((case.name, size, seed, way), WAYS[way](made))


def spread(values):
    """Mean and standard deviation in words."""
    return f"{np.mean(values):.2f} ± {np.std(values):.2f}" if len(values) else "-"


def table(cases, size, lines):
    """Print the table, and the figures over all scans."""
    print(f"RMSE within {NEAR_MM:g} mm of the object, % of mu; grids of {SPAN_MM:g} mm")
    print(f"| scan | {' | '.join(COLUMNS)} |\n|---|{'---|' * len(COLUMNS)}")
    ratios, over = {"sart": [], "sart, denoised": [], "seconds": []}, []
    doubts = []
    for case in cases:
        seeds = {}
        for (name, voxels, seed, _), found in lines.found.items():
            if (name, voxels) == (case.name, size or case.size):
                seeds.setdefault(seed, {}).update(found)
        row = []
        for column in COLUMNS:
            row.append(spread([f[column]["error"] for f in seeds.values() if column in f]))
        noise = "no noise" if case.photons is None else f"{case.photons:g} photons"
        kind = "mono" if case.main is None else "poly"
        told = f"{case.name}: {case.path}, {case.views} views, {noise}, {kind}"
        print(f"| {told} | {' | '.join(row)} |")
        for f in seeds.values():
            if "fast" in f and "sart" in f:
                for one in ("sart", "sart, denoised"):
                    ratios[one].append(f["fast"]["error"] / f[one]["error"])
                ratios["seconds"].append(f["fast"]["seconds"] / f["sart"]["seconds"])
            if "doubts" in f:
                error = f["doubts"]["error"] / f["sart"]["error"] if "sart" in f else np.nan
                doubts.append((f["doubts"]["warned"], case.name, error))
            if "auto" in f and "sart at 0.3" in f:
                over.append(100 * (f["auto"]["error"] / f["sart at 0.3"]["error"] - 1))
    for one, values in ratios.items():
        if values:
            told = "processor time" if one == "seconds" else "error"
            of = "sart" if one == "seconds" else one
            low, middle, high = np.quantile(values, (0, 0.5, 1))
            print(f"fast, {told} relative to {of}: {low:.2f} to {high:.2f}, median {middle:.2f}")
    if doubts:
        named = [f"{name} ({error:.2f} x)" for warned, name, error in doubts if warned]
        print(f"warnings: {len(named)} of {len(doubts)} scans, error to sart: {', '.join(named)}")
    if over:
        within = np.mean(np.array(over) <= 5)
        print(f"stop: auto above the best pass: median {np.median(over):.1f} %, at most", end=" ")
        print(f"{max(over):.1f} %, within 5 % in {100 * within:.0f} % of {len(over)} scans")


def main():
    """Measure what is not there yet, and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--held-out", action="store_true", help="the half that was set aside")
    parser.add_argument("--thin", action="store_true", help="further thin parts, for tuning")
    parser.add_argument("--cases", nargs="+", help="names of scans")
    parser.add_argument("--size", type=int, help="voxels along an edge")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--only", nargs="+", choices=tuple(WAYS), default=list(WAYS))
    parser.add_argument("--again", nargs="+", choices=tuple(WAYS), default=[])
    parser.add_argument("--quiet", action="store_true", help="no table")
    options = parser.parse_args()
    let_idle_threads_sleep()  # they would count as processor time
    options.out.mkdir(parents=True, exist_ok=True)
    lines = Lines(options.out / "zoo.jsonl", options.again)
    cases = HELD_OUT if options.held_out else THIN if options.thin else TUNING
    if options.cases:
        cases = [case for case in (*TUNING, *THIN, *HELD_OUT) if case.name in options.cases]
    for seed in range(options.first_seed, options.first_seed + options.seeds):
        for case in cases:
            measure(case, seed, options.size, options.only, lines)
    if not options.quiet:
        table(cases, options.size, lines)


if __name__ == "__main__":
    main()
