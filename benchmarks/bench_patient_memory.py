"""Peak memory of one process that scans, reconstructs and judges a patient of about 512^3 voxels.

    python benchmarks/bench_patient_memory.py [--views 399] [--out out/patient_512] [--one-image]

The patient is the head of the built-in grey phantom. A gantry takes the views, so that no room and
no gVXR are in the process. Printed: the peak of the whole run, and the largest sizes with the
functions that were at work then, sampled ten times a second. With ``--one-image``, all views show
the rays of the first one: that takes half the time, and as much memory.
"""

from __future__ import annotations

import argparse
import re
import sys
import threading
from pathlib import Path

import numpy as np

from twinct import run
from twinct.scenario import Scenario, parse_scenario
from twinct.specimen.grey_caster import GreyCaster

STATUS = Path("/proc/self/status")


def scenario_of(views: int) -> Scenario:
    """Return the scan of the head, whose grid has 567 x 525 x 401 voxels."""
    shape = {"kind": "volume", "phantom": "head", "voxel_mm": 0.387, "seed": 1, "centre": False}
    return parse_scenario(
        {
            "name": "patient_512",
            "source": {"energy_kev": 70},
            "detector": {"columns": 640, "rows": 480, "pixel_pitch_mm": 0.5},
            "specimen": {"reference": "skull", "parts": [{"name": "patient", "shape": shape}]},
            "trajectory": {"kind": "circle", "views": views, "sod_mm": 450, "sdd_mm": 720},
            "cell": {"kind": "gantry"},
            "reconstruction": {
                "algorithm": "sart",
                "iterations": 1,
                "grid": {"voxels": 512, "voxel_mm": 0.4},
            },
        }
    )


def gigabytes(name: str) -> float:
    """Return a number of the process's status, GB."""
    found = re.search(rf"{name}:\s+(\d+) kB", STATUS.read_text())
    assert found is not None
    return 1024e-9 * int(found[1])


class Watch(threading.Thread):
    """Keeps the largest size of the process for each function of twinct at work."""

    def __init__(self) -> None:
        """Watch the thread that calls this."""
        super().__init__(daemon=True)
        self.largest: dict[str, float] = {}
        self.ended = threading.Event()
        self._watched = threading.get_ident()

    def run(self) -> None:
        while not self.ended.wait(0.1):
            size, frame, names = gigabytes("VmRSS"), sys._current_frames()[self._watched], []
            while frame is not None:
                if "twinct" in frame.f_code.co_filename:
                    names.append(f"{Path(frame.f_code.co_filename).stem}.{frame.f_code.co_name}")
                frame = frame.f_back
            at = " < ".join(names[:3])
            self.largest[at] = max(size, self.largest.get(at, 0.0))


def repeat_first_image() -> None:
    """Let casters give the lengths of their first view for all others."""
    cast, first = GreyCaster.add, {}

    def add(self: GreyCaster, view, into, out) -> None:
        if self not in first:
            first[self] = np.zeros_like(out)
            cast(self, view, into, first[self])
        out += first[self]

    GreyCaster.add = add


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--views", type=int, default=399)
    parser.add_argument("--out", type=Path, default=Path("out/patient_512"))
    parser.add_argument("--one-image", action="store_true")
    options = parser.parse_args()
    if options.one_image:
        repeat_first_image()
    watch = Watch()
    watch.start()
    run(scenario_of(options.views), options.out, link="local")
    watch.ended.set()
    print(f"peak of the process: {gigabytes('VmHWM'):.2f} GB")
    for at, size in sorted(watch.largest.items(), key=lambda one: -one[1])[:12]:
        print(f"{size:.2f} GB in {at}")


if __name__ == "__main__":
    main()
