"""What the manifest of a scan store costs: writing and reading a scan of the paper's size.

Each is timed with the manifest and without it, in turn; the fastest of several counts.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import Pose
from twinct.geometry.wire import PosePairs, Reached
from twinct.runs import verify
from twinct.scan import ScanStore
from twinct.scenario import load_scenario
from twinct.trajectory import commanded_views

PAPER = Path(__file__).parents[1] / "scenarios" / "paper.yaml"
NAMES = tuple(f"joint_{number}" for number in range(12))
STATE = 200


def view(index: int) -> tuple[NDArray[np.float32], Reached]:
    """A noisy image with a shadow in it, as large as the paper's."""
    rng = np.random.default_rng(index)
    pose = Pose.from_euler(rng.normal(size=3), rng.uniform(-180, 180, 3))
    y, x = np.mgrid[-240:240, -320:320]
    shadow = np.exp(-3 * np.exp(-(x**2 + y**2) / 2e4), dtype=np.float32)
    image = shadow * (1 + 0.01 * rng.standard_normal(shadow.shape, dtype=np.float32))
    executed = PosePairs.at(pose, pose, pose)
    position, velocity, effort = rng.random((3, len(NAMES)))
    joints = NAMES, position, velocity, effort
    return image, Reached(executed, *joints, rng.random(STATE), float(index), 10.0)


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--views", type=int, default=399)
    parser.add_argument("--rounds", type=int, default=3)
    options = parser.parse_args()
    scenario = load_scenario(PAPER, [f"trajectory.views={options.views}"])
    geometry = commanded_views(scenario.trajectory, scenario.detector.panel)
    commanded = PosePairs.from_geometry(geometry)
    views = [view(index) for index in range(20)]
    writing: dict[bool, list[float]] = {True: [], False: []}
    reading: dict[bool, list[float]] = {True: [], False: []}
    with tempfile.TemporaryDirectory() as folder:
        stores: dict[bool, ScanStore] = {}
        for vouched in (True, False):
            path = Path(folder) / f"{vouched}.zarr"
            store = ScanStore.create(path, scenario, commanded, NAMES, STATE)
            if not vouched:
                shutil.rmtree(path / "manifest")
                metadata = path / "zarr.json"  # of the format before
                metadata.write_text(metadata.read_text().replace('"format": 4', '"format": 3'))
                store = ScanStore(path)
            stores[vouched] = store
        for index in range(options.views):
            for vouched, store in stores.items():
                start = time.perf_counter()
                store.write(index, *views[index % len(views)])
                writing[vouched].append(time.perf_counter() - start)
        for _ in range(options.rounds):
            for vouched, store in stores.items():
                start = time.perf_counter()
                ScanStore(store.path).read()
                reading[vouched].append(time.perf_counter() - start)
        start = time.perf_counter()
        assert not verify(stores[True].path).problems
        looked = time.perf_counter() - start
    write = {vouched: 1000 * float(np.median(seconds)) for vouched, seconds in writing.items()}
    read = {vouched: min(seconds) for vouched, seconds in reading.items()}
    print(
        f"{options.views} views, with and without manifest: writing {write[True]:.1f} and "
        f"{write[False]:.1f} ms a view, reading {read[True]:.2f} and {read[False]:.2f} s "
        f"({read[True] / read[False]:.2f} x); verify {looked:.2f} s"
    )


if __name__ == "__main__":
    main()
