"""Where `stop: auto` ends a reconstruction, against the best of 20 passes, by noise of the poses.

python benchmarks/bench_stopping.py --out out/stopping
python benchmarks/bench_stopping.py --out out/stopping --sigma 0.3 --seeds 1 --every 4

The paper's path is scanned once, on 320 x 240 pixels, into OUT/scan (``--scan`` takes a run's
folder instead; ``--factor 2`` voxels and pixels twice as large, ``--every 4`` each fourth view);
the poses' noise is drawn anew for each seed, cut off at 1.5 sigma as the paper's. Errors are those
within 3 mm of bone in the region that every view sees. `sart` makes ``--passes`` passes; the rule
judges each and would have ended before the first that it finds worse. `fast`, with whose volume the
rule compares them, is a line of its own. With ``--until 1.25`` runs end once their error is so many
times the lowest: errors that have begun to rise do so to the end (noise 0 and 0.1 mm were run to
pass 20 to see it).

Each pass is a line of OUT/passes-VOXELS-VIEWS.jsonl; what is there is not done again, and `sart`
goes on from its newest volume. Another scan, or other photons, surroundings, relaxation or bounds
belong into another OUT.
"""

import argparse
import itertools
import json
import time
from pathlib import Path

import numpy as np
from bench_quality import COARSE_MM, Case
from scipy import ndimage

import twinct
from twinct.core.files.writing import complete
from twinct.recon import fast, sart, without_surroundings
from twinct.recon.error_estimate import error_estimate
from twinct.runs.reconstruction import derive_geometry
from twinct.scan import line_integrals
from twinct.scenario import load_scenario

PAPER = Path(__file__).parents[1] / "scenarios" / "paper.yaml"
SCAN = (
    *("detector.columns=320", "detector.rows=240", "detector.pixel_pitch_mm=1.0"),
    "reconstruction.grid={voxels: 256, voxel_mm: 0.62}",
    "reconstruction.iterations=1",
)
NEAR_MM = 3.0
CUT_OFF = 1.5
"""Of the noise, in sigma: 0.15 mm for the paper's 0.1 mm."""


class Lines:
    """What was measured, a line each; a broken last line of a killed run counts for nothing."""

    def __init__(self, path):
        self.path = path
        self.kept = []
        for line in path.read_text().splitlines() if path.exists() else ():
            try:
                self.kept.append(json.loads(line))
            except json.JSONDecodeError:
                print(f"ignored: {line[:60]}")
        path.write_text("".join(json.dumps(one) + "\n" for one in self.kept))

    def add(self, **told):
        """Keep a line, and show it."""
        self.kept.append(told)
        with self.path.open("a") as stream:
            stream.write(json.dumps(told) + "\n")
        print("  " + ", ".join(f"{key} {value}" for key, value in told.items()), flush=True)

    def of(self, **asked):
        """All lines with these values."""
        return [one for one in self.kept if asked.items() <= one.items()]


def geometry_of(folder, sigma, seed):
    """The name of the believed poses with such noise, derived from the scan once."""
    if not sigma:
        return "executed"
    name = f"noise-{sigma:g}-{seed}"
    sides = [f"uncertainty.{side}" for side in ("source", "detector")]
    sizes = [f"{side}.sigma_mm={sigma}" for side in sides]
    cuts = [f"{side}.cutoff_mm={CUT_OFF * sigma:g}" for side in sides]
    derive_geometry(folder, name, [*sizes, *cuts, f"uncertainty.seed={seed}"])
    return name


class Judged(Case):
    """The scan with photon noise, without what lies around the grid, and its voxels near bone."""

    def __init__(self, folder, geometry, options):
        super().__init__(folder, geometry, options.factor, options.every)
        far = ndimage.distance_transform_edt(
            self.truth < 0.5 * self.mu, sampling=self.grid.voxel[::-1]
        )
        self.near = (far <= NEAR_MM) & self.region
        if options.photons:
            counts = np.random.default_rng(1).poisson(options.photons * np.exp(-self.p))
            self.p = line_integrals((counts / options.photons).astype(np.float32))
        if options.surroundings:
            coarse = {"margin_mm": options.surroundings, "voxel_mm": COARSE_MM}
            self.p = without_surroundings(self.A, self.p, **coarse)

    def error(self, volume):
        """RMSE within 3 mm of bone as ``ImageFigures`` has it, % of mu(bone)."""
        square = np.square((volume - self.truth)[self.near], dtype=np.float64)
        return round(100 * float(np.sqrt(square.mean())) / self.mu, 4)


def of_sart(case, lines, options, which):
    """Pass after pass, each from the volume before, as one run has them to the last bit."""
    named = {"way": "sart", **which}
    size = f"{case.grid.shape[0]}-{len(case.A)}-{which['sigma_mm']:g}-{which['seed']}"
    if not lines.of(way="fast", **which):
        lines.add(way="fast", **which, error=case.error(fast(case.A, case.p).array))
    estimate = error_estimate(case.A, case.p, None, None)
    newest, done, x = options.out / f"newest-{size}.npz", 0, None
    if newest.exists():
        with np.load(newest) as content:
            done, x = int(content["done"]), content["x"]
    for number in range(done + 1, options.passes + 1):
        if risen(lines.of(**named), options.until):
            break
        start = time.perf_counter()
        keys = {"relaxation": options.relaxation, "nonnegative": options.nonnegative}
        made = sart(case.A, case.p, iterations=1, x0=x, **keys).array
        middle = time.perf_counter()
        estimated = estimate(made)
        end = time.perf_counter()
        x = made
        if not lines.of(**named, number=number):
            seconds = {"pass_s": round(middle - start, 1), "judging_s": round(end - middle, 1)}
            lines.add(**named, number=number, error=case.error(x), estimated=estimated, **seconds)
        with complete(newest) as draft:
            np.savez(draft, done=number, x=x)
        left = (options.passes - number) * (time.perf_counter() - start)
        print(f"  {left / 60:.0f} min to the end of this run", flush=True)


def risen(points, factor):
    """Whether the newest error is so many times the lowest."""
    errors = [point["error"] for point in points]
    return bool(errors) and errors[-1] >= factor * min(errors)


def chosen(points):
    """The last pass before the first that was found worse."""
    for before, after in itertools.pairwise(points):
        if after["estimated"] > before["estimated"]:
            return before
    return points[-1]


def summary(lines, sigmas):
    """One line for each noise."""
    for sigma in sigmas:
        found = []
        for seed in sorted({one["seed"] for one in lines.of(sigma_mm=sigma)}):
            points = lines.of(way="sart", sigma_mm=sigma, seed=seed)
            if points:
                own, best = chosen(points), min(points, key=lambda point: point["error"])
                found.append(
                    (own["number"], own["error"], best["number"], best["error"], len(points))
                )
        if found:
            over = [100 * (own / best - 1) for _, own, _, best, _ in found]
            print(f"noise {sigma:g} mm: {max(over):.1f} % above the best at most", found)


def main():
    """Measure what is asked for and not there yet."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--scan", type=Path)
    parser.add_argument("--factor", type=int, default=1)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--photons", type=float, help="photons per pixel; default: no noise")
    parser.add_argument("--surroundings", type=float, help="margin to remove, mm")
    parser.add_argument("--nonnegative", action="store_true")
    parser.add_argument("--relaxation", type=float, default=0.3)
    parser.add_argument("--passes", type=int, default=20)
    parser.add_argument("--until", type=float, default=np.inf, metavar="FACTOR")
    parser.add_argument("--sigma", type=float, nargs="+", default=[0.0, 0.1, 0.3])
    parser.add_argument("--seeds", type=int, default=5)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    folder = options.scan or options.out / "scan"
    if options.scan is None:
        scenario = load_scenario(PAPER, list(SCAN))
        twinct.run(scenario, folder, link="local", resume=folder.exists())
    # All noises with one seed first: a run that is cut short has seen each.
    wanted = [
        (sigma, seed)
        for seed in range(1, options.seeds + 1)
        for sigma in options.sigma
        if sigma or seed == 1
    ]
    lines = None
    for sigma, seed in wanted:
        case = Judged(folder, geometry_of(folder, sigma, seed), options)
        name = f"passes-{case.grid.shape[0]}-{len(case.A)}.jsonl"
        lines = lines or Lines(options.out / name)
        which = {"sigma_mm": sigma, "seed": seed}
        print(f"noise {sigma:g} mm, seed {seed}", flush=True)
        of_sart(case, lines, options, which)
        summary(lines, options.sigma)


if __name__ == "__main__":
    main()
