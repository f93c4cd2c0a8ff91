"""What algorithms reach in what time, on one scan: error near bone over seconds.

python benchmarks/bench_quality.py out/paper --factor 2 --out quality
python benchmarks/bench_quality.py out/paper --out quality --only sart fast

The scan is a run's folder. ``--factor 2`` takes voxels and pixels twice as large, ``--every 4``
each fourth view. Each way of reconstructing is judged after each of its passes (``--each 4``: each
fourth), in the region that every view sees and against the run's truth; seconds are those of the
algorithm alone. What is there already in OUT is not done again: a benchmark that was interrupted
goes on. ``rtk`` is RTK's own SART, of ``--rtk`` passes. ``fdk`` is not among them: it wants a
circle; nor is ``prior_tv``, which wants an earlier volume (bench_prior.py).
"""

import argparse
import json
import time
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from denoised import lowered

from twinct.evaluation import edge_width, image_figures, region_of_interest
from twinct.recon import (
    Projector,
    cgls,
    fast,
    os_sart,
    rtk_sart,
    sart,
    sirt,
    without_surroundings,
)
from twinct.recon.fista_tv import PASSES, TOLERANCE
from twinct.recon.resolution import binned
from twinct.recon.volume import Volume
from twinct.runs.reconstruction import load_scan
from twinct.scan import line_integrals

MARGIN_MM, COARSE_MM = 50.0, 2.5
"""Of the surroundings: the defaults; the skulls reach 25 mm beyond the paper's grid."""

STRENGTHS = (0.01, 0.03, 0.06, 0.12, 0.25)
"""Strengths of the denoised baselines, in voxel edges times mu(bone), as in zoo.py."""


class Case:
    """The scan of a run, in larger pixels and voxels, and what its volumes are judged against."""

    def __init__(self, folder, geometry, factor, every):
        scan = load_scan(folder)
        panel, grid = scan.scenario.detector.panel, scan.scenario.reconstruction.grid.volume_grid
        views = slice(0, None, every)
        transmission, _ = binned(scan.transmission[views], None, (factor, factor))
        truth = Volume.read(Path(folder) / "truth.nii").array
        self.p = line_integrals(transmission)
        self.grid = grid.with_voxels(factor * grid.voxel)
        self.truth = fewer_voxels(truth, factor)
        self.region = region_of_interest(scan.executed.geometry(panel)[views], self.grid)
        self.mu = float(truth.max())
        believed = scan.poses(geometry).geometry(panel)[views]
        self.A = Projector(believed.binned(factor, factor), self.grid)

    def judged(self, volume, seconds, passes):
        """A point of the picture."""
        found = image_figures(volume, self.truth, self.region, self.mu, self.grid)
        width = edge_width(volume, self.truth, self.region, self.mu, self.grid)
        return {
            "passes": passes,
            "seconds": seconds,
            "rmse_rel": found.rmse_rel,
            "rmse_near_rel": found.rmse_near_rel,
            "edge_width_mm": width,
        }


def fewer_voxels(volume, factor):
    """Means of blocks of voxels, plane by plane."""
    z, y, x = (n // factor for n in volume.shape)
    blocks = (volume[i * factor : (i + 1) * factor] for i in range(z))
    return np.stack([b.reshape(factor, y, factor, x, factor).mean((0, 2, 4)) for b in blocks])


def as_it_is(case, volume):
    """Yield a volume."""
    yield volume


def clipped(case, volume):
    """Yield a volume without negative voxels."""
    yield np.maximum(volume, 0)


def denoised(case, volume):
    """Yield a volume without negative voxels and with less total variation, for each strength."""
    for strength in STRENGTHS:
        size = strength * case.mu * float(case.grid.voxel.mean()) ** 2
        yield lowered(case.A, np.maximum(volume, 0), size)


def passes_of(case, solve, options, seconds=0.0, finish=as_it_is):
    """Judge volumes between passes of an algorithm that calls back; the clock stands still.

    Of the volumes that ``finish`` makes of one, the best counts.
    """
    points, clock = [], [time.perf_counter() - seconds]

    def watch(step):
        if step.update + 1 == step.updates and (step.iteration + 1) % options.each == 0:
            spent = time.perf_counter() - clock[0]
            passes = step.iteration + 1
            judged = (case.judged(one, spent, passes) for one in finish(case, step.volume))
            points.append(min(judged, key=lambda point: point["rmse_near_rel"]))
            print(f"  {points[-1]['seconds']:.1f} s: {points[-1]['rmse_near_rel']:.4f}", flush=True)
            clock[0] = time.perf_counter() - spent

    solve(iterations=options.iterations, callback=watch)
    return points


def plain_sart(case, options, found):
    """The paper's."""
    return passes_of(case, lambda **more: sart(case.A, case.p, relaxation=0.3, **more), options)


def better(algorithm, finish=as_it_is, **settings):
    """An algorithm after the surroundings were taken out, without negative voxels where it can."""

    def way(case, options, found):
        start = time.perf_counter()
        rest = without_surroundings(case.A, case.p, margin_mm=MARGIN_MM, voxel_mm=COARSE_MM)
        return passes_of(
            case,
            lambda **more: algorithm(case.A, rest, **settings, **more),
            options,
            time.perf_counter() - start,
            finish,
        )

    return way


def whole(case, solve, passes):
    """One point, of an algorithm that is one call."""
    start = time.perf_counter()
    volume = solve().array
    return [case.judged(volume, time.perf_counter() - start, passes)]


def by_default(case, options, found):
    """``fast`` with its defaults; the number of passes at full resolution is counted."""
    updates = []

    def count(step):
        if step.volume.shape == case.A.domain_shape:
            updates.append(step.update)

    point = whole(case, lambda: fast(case.A, case.p, callback=count), 0)[0]
    return [point | {"passes": len(updates) / len(case.A)}]


def preset(passes):
    """``fast``, with so many passes at full resolution."""
    return lambda case, options, found: whole(
        case, lambda: fast(case.A, case.p, passes=passes), passes
    )


def eighth(case, options, found):
    """``fast``, stopped in its last pass after an eighth of the time of SART's ten."""
    if "sart" not in found:
        raise SystemExit("no time of sart to compare with: give --only sart too, before it")
    last = found["sart"][-1]
    limit = 10 * last["seconds"] / last["passes"] / 8
    start = time.perf_counter()
    volume = fast(case.A, case.p, callback=lambda step: time.perf_counter() - start > limit).array
    return [case.judged(volume, time.perf_counter() - start, 1)]


def rtks(case, options, found):
    """RTK's SART, one pass a call."""
    points, volume, seconds = [], None, 0.0
    for number in range(1, options.rtk + 1):
        start = time.perf_counter()
        volume = rtk_sart(
            case.p, case.A.geometry, case.grid, iterations=1, relaxation=0.3, x0=volume
        ).array
        seconds += time.perf_counter() - start
        points.append(case.judged(volume, seconds, number))
    return points


WAYS = {
    "sart": (plain_sart, "sart, relaxation 0.3 (the paper's)"),
    "sart, surroundings": (
        better(sart, relaxation=0.3, nonnegative=True),
        "sart, surroundings out, non-negative",
    ),
    "sart, denoised": (
        better(sart, denoised, relaxation=0.3, nonnegative=True),
        "sart, surroundings out, with the best of five strengths of total variation",
    ),
    "fast": (by_default, "fast"),
    "fast 1": (preset(1), "fast, one pass"),
    "fast 2": (preset(2), "fast, two passes"),
    "fast 3": (preset(3), "fast, three passes"),
    "eighth": (eighth, "fast, stopped at 1/8 of the time of SART's ten passes"),
    "os_sart": (
        better(
            lambda A, p, **more: os_sart(
                A, p, relaxation=1.0, subsets=-(-len(A) // 10), nonnegative=True, **more
            )
        ),
        "os_sart, 10 views a subset, relaxation 1, surroundings out, non-negative",
    ),
    "sirt": (
        better(sirt, relaxation=1.0, nonnegative=True),
        "sirt, surroundings out, non-negative",
    ),
    "cgls": (better(cgls, clipped), "cgls, surroundings out, clipped at 0"),
    "cgls, denoised": (
        better(cgls, denoised),
        "cgls, surroundings out, with the best of five strengths of total variation",
    ),
    "fista_tv": (better(fast, passes=PASSES, tolerance=TOLERANCE), "fista_tv, surroundings out"),
    "rtk": (rtks, "RTK's SART"),
}


def draw(found, path, title):
    """Error near bone over seconds."""
    figure, axes = plt.subplots(figsize=(8, 6), layout="constrained")
    for number, name in enumerate(name for name in WAYS if name in found):
        seconds = [point["seconds"] for point in found[name]]
        errors = [100 * point["rmse_near_rel"] for point in found[name]]
        look = {
            "marker": "osD^vP"[number % 6],
            "ms": 4,
            "color": plt.get_cmap("tab20")(2 * number % 20 + number // 10),
        }
        axes.plot(seconds, errors, label=WAYS[name][1], **look)
    axes.set(
        xscale="log",
        yscale="log",
        xlabel="seconds",
        ylabel="RMSE within 3 mm of bone, % of mu(bone)",
    )
    axes.set_title(title)
    axes.grid(alpha=0.3, which="both")
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter("{x:g}")
    figure.legend(loc="outside lower center", ncols=2, fontsize=7)
    figure.savefig(path, dpi=120)


def main():
    """Reconstruct in each way that is asked for and not there yet."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("folder")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--geometry", default="believed")
    parser.add_argument("--factor", type=int, default=1)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--iterations", type=int, default=10)
    parser.add_argument("--each", type=int, default=1, help="number of passes between judgements")
    parser.add_argument("--rtk", type=int, default=1)
    parser.add_argument("--only", nargs="+", choices=WAYS, default=list(WAYS))
    options = parser.parse_args()
    case = Case(options.folder, options.geometry, options.factor, options.every)
    name = f"{options.geometry}-{case.grid.shape[0]}-{len(case.A)}"
    options.out.mkdir(parents=True, exist_ok=True)
    kept = options.out / f"{name}.json"
    found = json.loads(kept.read_text()) if kept.exists() else {}
    for way in options.only:
        if way not in found:
            print(way, flush=True)
            found[way] = WAYS[way][0](case, options, found)
            kept.write_text(json.dumps(found, indent=1))
    for way, points in found.items():
        best = min(points, key=lambda point: point["rmse_near_rel"])
        print(
            f"{WAYS[way][1]}: {100 * best['rmse_near_rel']:.2f} % near bone after "
            f"{best['passes']} passes, {best['seconds']:.0f} s; "
            f"edges {best['edge_width_mm']:.2f} mm; all passes {points[-1]['seconds']:.0f} s"
        )
    views, rows, columns = case.A.range_shape
    size = f"{case.grid.shape[0]}³ voxels, {views} views of {columns} x {rows}"
    draw(found, options.out / f"{name}.png", f"{size}, {options.geometry} poses")


if __name__ == "__main__":
    main()
