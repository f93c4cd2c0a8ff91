"""What it costs to write a small file, and a view of a scan, completely or not at all.

A small file is the worst case: its draft, lock and rename outweigh its bytes. The view is the
smallest, of one pixel, and that of the paper. The fastest of several rounds counts.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from bench_store import NAMES, PAPER, STATE, view

from twinct.core.files.writing import write_text
from twinct.geometry.wire import PosePairs
from twinct.scan import ScanStore
from twinct.scan.status import mark_acquired
from twinct.scenario import load_scenario
from twinct.trajectory import commanded_views


def fastest_us(work: Callable[[int], object], times: int, rounds: int) -> float:
    """Return the time of one call, in microseconds, in the fastest of several rounds."""
    taken: list[float] = []
    for number in range(rounds):
        began = time.perf_counter()
        for index in range(times):
            work(number * times + index)
        taken.append((time.perf_counter() - began) / times)
    return 1e6 * min(taken)


def stored(folder: Path, rows: int, columns: int, times: int, rounds: int) -> float:
    """Return the time to store a view of a scan, in microseconds."""
    keys = {"trajectory.views": times * rounds, "detector.rows": rows, "detector.columns": columns}
    scenario = load_scenario(PAPER, [f"{key}={value}" for key, value in keys.items()])
    geometry = commanded_views(scenario.trajectory, scenario.detector.panel)
    commanded = PosePairs.from_geometry(geometry)
    store = ScanStore.create(folder / f"{rows}.zarr", scenario, commanded, NAMES, STATE)
    image, reached = view(0)
    image = np.ascontiguousarray(image[:rows, :columns])
    return fastest_us(lambda index: store.write(index, image, reached), times, rounds)


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--folder", type=Path, help="where to write; default: temporary files")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder) as name:
        folder = Path(name)
        (status := folder / "status").mkdir()
        figures = {
            "a text of 100 bytes": fastest_us(
                lambda index: write_text(folder / f"{index % 10}.txt", "x" * 100),
                500,
                options.rounds,
            ),
            "the status of a view": fastest_us(
                lambda index: mark_acquired(folder, index), 200, options.rounds
            ),
            "a view of one pixel": stored(folder, 1, 1, 40, options.rounds),
            "a view of 640 x 480": stored(folder, 480, 640, 40, options.rounds),
        }
        assert any(status.iterdir())
    for what, taken_us in figures.items():
        print(f"{what}: {taken_us:.0f} us")


if __name__ == "__main__":
    main()
