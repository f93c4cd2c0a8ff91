"""Choices of views: iterated exchange against the integer optimum.

    python benchmarks/bench_planning.py [--seeds 100 124]

60 random candidates of the paper's distances and panel, 12 of them chosen; a candidate covers the
planes, 25 of each of 12 random points within 60 mm of the isocentre, that pass within an angle of
its source. The angle of each instance is raised until the optimum covers 60 to 90 %.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from twinct.geometry import Panel, ScanGeometry
from twinct.trajectory import panel_axes
from twinct.view_planning import (
    Coverage,
    Goal,
    Searched,
    covered_share,
    crossed_planes,
    exact_choice,
    search_views,
)

CANDIDATES, NUMBER, POINTS, NORMALS = 60, 12, 12, 25
PANEL = Panel(480, 640, 0.5, 0.5)
ANGLES_DEG = (2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
COVERED = 0.6, 0.9


def searched(covers) -> Searched:
    """Return the search as ``twinct plan`` makes it."""
    return search_views([Goal("planes", Coverage(covers), 1.0)], CANDIDATES, NUMBER)


def instance(seed: int):
    """Which planes each candidate covers, and by what angle."""
    rng = np.random.default_rng([seed, 15])
    towards = rng.normal(size=(CANDIDATES, 3))
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    geometry = ScanGeometry(300 * towards, -300 * towards, *panel_axes(towards), PANEL)
    points = rng.normal(size=(POINTS, 3))
    points *= 60 * rng.random((POINTS, 1)) ** (1 / 3) / np.linalg.norm(points, axis=1)[:, None]
    for angle in ANGLES_DEG:
        covers = crossed_planes(geometry, points, angle, NORMALS)
        if searched(covers).worth[-1] > COVERED[0] + 0.02:
            return covers, angle
    raise SystemExit(f"instance {seed}: no angle covers enough")


def main() -> None:
    """All instances, and their mean and worst."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs=2, default=(100, 124), help="first, behind last")
    parser.add_argument("--seconds", type=float, default=600.0)
    options = parser.parse_args()
    ratios: list[tuple[float, float, float]] = []
    for seed in range(*options.seeds):
        covers, angle = instance(seed)
        worth = searched(covers).worth
        start = time.perf_counter()
        exact = exact_choice(covers, NUMBER, seconds=options.seconds)
        seconds = time.perf_counter() - start
        best = max(exact.bound, exact.share)  # what no choice exceeds
        lucky = np.random.default_rng(seed).permutation(CANDIDATES)[:NUMBER].tolist()
        ratios.append(
            (
                worth[NUMBER - 1] / best,
                worth[-1] / best,
                covered_share(covers, lucky) / best,
            )
        )
        print(
            f"{seed}: within {angle:g} deg, optimum {exact.share:.4f} (bound {exact.bound:.4f}, "
            f"{seconds:.0f} s), greedy {ratios[-1][0]:.4f}, with exchange {ratios[-1][1]:.4f}, "
            f"random {ratios[-1][2]:.4f} of the optimum",
            flush=True,
        )
        assert COVERED[0] <= exact.share <= COVERED[1], "the optimum must cover 60 to 90 %"
    for name, shares in zip(
        ("greedy", "with exchange", "random"), zip(*ratios, strict=True), strict=True
    ):
        print(
            f"{name}: median {np.median(shares):.4f}, mean {np.mean(shares):.4f}, "
            f"worst {min(shares):.4f} of the optimum"
        )


if __name__ == "__main__":
    main()
