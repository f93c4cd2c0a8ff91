"""Error and time of ``fast`` on random scans, against SART at its best of 20 passes.

python benchmarks/bench_objective.py --out out/objective --first 1000 --scans 200
python benchmarks/bench_objective.py --out out/objective --first 0 --scans 19 --voxels 48 --stop
python benchmarks/bench_objective.py --out out/objective --show

Scans are those of ``random_scans``: seeds 0 to 99 are for tuning, so a record takes others. SART is
non-negative, with relaxations of 0.3 and 1, and its best pass is chosen by the truth. "Detail" is
how much of the truth's structure below two voxels a volume shows: its projection on the truth less
the smoothed truth, near the object. Time is relative to that of SART for its best number of passes,
but at least five. With ``--stop``, also the error of ``sart`` with ``stop: auto`` and after five
passes, relative to its best, with the default relaxation. With ``--budgets``, also the errors of
``fast`` and ``fista_tv`` relative to the objective's minimum at its best of nine strengths, a
factor of two apart about that of ``fast``; a minimum ends when a pass changes the volume by less
than 1e-4, or after 300 passes.

Each scan is a line of OUT/objective.jsonl; one that is there is not made again. Beside other work,
use TWINCT_THREADS=1.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
from random_scans import TUNING, RandomScan, random_scan
from scipy.ndimage import gaussian_filter

from twinct.core.threads import let_idle_threads_sleep
from twinct.recon import fast, sart
from twinct.recon.fista_tv import PASSES as PASSES_TV
from twinct.recon.fista_tv import TOLERANCE as TOLERANCE_TV
from twinct.recon.volume import Volume

PASSES, RELAXATIONS, LEAST = 20, (0.3, 1.0), 5
DETAIL = 2.0
STOPPED = 0.3
STRENGTHS, CLOSE, MOST = range(-4, 5), 1e-4, 300


def main() -> None:
    """Make the scans that are missing, and print the figures of all."""
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n", maxsplit=1)[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--first", type=int, default=TUNING, help="first seed")
    parser.add_argument("--scans", type=int, default=20)
    parser.add_argument("--voxels", type=int, help="along an axis, instead of the drawn number")
    parser.add_argument("--stop", action="store_true", help="also `stop: auto`")
    parser.add_argument("--budgets", action="store_true", help="also the minimum at its best")
    parser.add_argument("--show", action="store_true", help="only print what is there")
    given = parser.parse_args()
    let_idle_threads_sleep()
    given.out.mkdir(parents=True, exist_ok=True)
    file = given.out / "objective.jsonl"
    rows = [json.loads(line) for line in file.open()] if file.exists() else []
    there = {(row["seed"], row["asked"]) for row in rows}
    for seed in range(given.first, given.first + given.scans):
        if given.show or (seed, given.voxels) in there:
            continue
        row = judged(
            random_scan(seed, given.voxels, given.out / "scans"), given.stop, given.budgets
        )
        rows.append(row | {"asked": given.voxels})
        with file.open("a") as lines:
            lines.write(json.dumps(rows[-1]) + "\n")
        print(line(rows[-1]), flush=True)
    show(rows)


def judged(scan: RandomScan, stop: bool, budgets: bool) -> dict[str, object]:
    """Return the figures of one scan."""
    A, p, views = scan.A, scan.p, len(scan.A)
    detail = scan.truth - gaussian_filter(scan.truth, DETAIL)
    square = float(np.sum(detail[scan.near] ** 2))

    def shown(x: np.ndarray) -> float:
        return float(
            np.sum((x * detail)[scan.near] - (gaussian_filter(x, DETAIL) * detail)[scan.near])
            / square
        )

    fast(A[:2], p[:2])  # loads the kernels
    errors, details = {}, {}
    clock = time.perf_counter()
    for relaxation in RELAXATIONS:

        def watch(step, relaxation=relaxation):
            if step.update + 1 == step.updates:
                errors[relaxation, step.iteration + 1] = scan.error(step.volume)
                details[relaxation, step.iteration + 1] = shown(step.volume)

        sart(A, p, iterations=PASSES, relaxation=relaxation, nonnegative=True, callback=watch)
    best = min(errors, key=errors.__getitem__)
    clock = time.perf_counter()
    sart(A, p, iterations=LEAST, relaxation=best[0], nonnegative=True)
    a_pass = (time.perf_counter() - clock) / LEAST
    clock = time.perf_counter()
    volume = fast(A, p, photons=scan.photons)
    spent = time.perf_counter() - clock
    row = {
        "seed": scan.seed,
        "family": scan.family,
        "path": scan.path,
        "voxels": max(A.domain_shape),
        "views": views,
        "photons": scan.photons,
        "sart": errors[best],
        "best": best,
        "sart_detail": details[best],
        "fast": scan.error(volume.array),
        "fast_detail": shown(volume.array),
        "passes": volume.extras["passes"],
        "time": spent / (a_pass * max(LEAST, best[1])),
    }
    if stop:
        own = {made: error for (relaxation, made), error in errors.items() if relaxation == STOPPED}
        chosen = sart(
            A,
            p,
            iterations=PASSES,
            relaxation=STOPPED,
            nonnegative=True,
            stop="auto",
            photons=scan.photons,
        ).extras["passes"]
        row |= {"auto": own[chosen] / min(own.values()), "five": own[5] / min(own.values())}
    return row | (against_minimum(scan, row["fast"], volume) if budgets else {})


def against_minimum(scan: RandomScan, error: float, volume: Volume) -> dict[str, object]:
    """Return the errors of both budgets relative to the minimum at its best strength."""
    A, p, photons = scan.A, scan.p, scan.photons
    larger = fast(A, p, photons=photons, passes=PASSES_TV, tolerance=TOLERANCE_TV)
    found = volume.extras["regularisation"]["strength"]
    minima = {}
    for power in STRENGTHS:
        strength = found * 2.0**power
        minimum = fast(A, p, photons=photons, passes=MOST, tolerance=CLOSE, strength=strength)
        minima[power] = scan.error(minimum.array), minimum.extras["passes"]
    best = min(minima, key=lambda power: minima[power][0])
    return {
        "fast_minimum": error / minima[best][0],
        "larger_minimum": scan.error(larger.array) / minima[best][0],
        "larger_passes": larger.extras["passes"],
        "best_power": best,
        "minima": minima,
    }


def line(row: dict) -> str:
    """Return the figures of one scan in a line."""
    what = f"{row['seed']} {row['family']} {row['path']}, {row['voxels']} voxels"
    photons = "no noise" if row["photons"] is None else f"{row['photons']:.0f} photons"
    ratio = row["fast"] / row["sart"]
    relaxation, number = row["best"]
    text = f"{what}, {row['views']} views, {photons}: fast {row['fast']:.4f}, {ratio:.2f} x SART's "
    text += f"pass {number} of {relaxation}; detail {row['fast_detail']:.2f}, "
    text += f"{row['sart_detail']:.2f}; {row['time']:.2f} x its time"
    if "larger_minimum" in row:
        text += f"; of the minimum {row['fast_minimum']:.3f}, fista_tv {row['larger_minimum']:.3f} "
        text += f"({row['larger_passes']} passes; 2^{row['best_power']})"
    return text + (f"; auto {row['auto']:.2f}, five {row['five']:.2f}" if "auto" in row else "")


def show(rows: list[dict]) -> None:
    """Print medians, 95th percentiles and largest values."""
    columns = {
        "fast / SART": [row["fast"] / row["sart"] for row in rows],
        "detail of SART / fast": [row["sart_detail"] / row["fast_detail"] for row in rows],
        "time": [row["time"] for row in rows],
        "time, 128 voxels and more": [row["time"] for row in rows if row["voxels"] >= 128],
        "stop: auto / best": [row["auto"] for row in rows if "auto" in row],
        "fast / minimum": [row["fast_minimum"] for row in rows if "fast_minimum" in row],
        "fista_tv / minimum": [row["larger_minimum"] for row in rows if "larger_minimum" in row],
        "five passes / best": [row["five"] for row in rows if "five" in row],
    }
    for family in sorted({row["family"] for row in rows}):
        own = [row["fast"] / row["sart"] for row in rows if row["family"] == family]
        columns[f"fast / SART, {family}"] = own
    print(f"{len(rows)} scans, seeds {sorted({row['seed'] for row in rows})}")
    for name, values in columns.items():
        if values:
            middle, high = np.percentile(values, [50, 95])
            print(f"{name} ({len(values)}): {middle:.3f}; {high:.3f}; at most {max(values):.3f}")


if __name__ == "__main__":
    main()
