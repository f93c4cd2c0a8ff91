"""How much recording slows a scan over ROS 2 of the paper's size, and how large the file is.

    python benchmarks/bench_record.py [VIEWS]

Two rigs of the same scan take the same views in turns, one of them recorded, so that whatever else
the machine does slows both.
"""

import json
import sys
import tempfile
import time
from contextlib import closing
from pathlib import Path

import numpy as np

from twinct.link import ros_rigs
from twinct.link.recording import recorder_of
from twinct.scan import SimulationBuilder
from twinct.scenario import load_scenario

BYTES = 4 + 1
"""Of a pixel of an image, and of what viewers show of it."""

HERE = Path(__file__).parent


def main() -> None:
    views = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    builder = SimulationBuilder(load_scenario(HERE.parent / "scenarios" / "paper.yaml"))
    targets, panel = builder.targets[:views], builder.scenario.detector.panel
    taken = np.zeros((views, 2))
    with tempfile.TemporaryDirectory() as folder:
        recording = recorder_of("ros2", Path(folder))
        make_rigs = ros_rigs(), recording.rigs(ros_rigs(hear=recording.hear))
        with (
            closing(recording),
            closing(make_rigs[0](builder, 0, None)) as plain,
            closing(make_rigs[1](builder, 0, None)) as recorded,
        ):
            rigs = plain, recorded
            for view, target in enumerate(targets):
                for which in (0, 1) if view % 2 else (1, 0):
                    start = time.perf_counter()
                    rigs[which].move(view, target)
                    rigs[which].expose(view)
                    taken[view, which] = time.perf_counter() - start
        size = recording.path.stat().st_size
    alone, beside = taken.sum(axis=0)
    print(
        json.dumps(
            {
                "views": views,
                "seconds": [round(alone, 2), round(beside, 2)],
                "slower": round(beside / alone - 1, 4),
                "slower, median view": round(float(np.median(taken[:, 1] - taken[:, 0])), 4),
                "file / images": round(size / (BYTES * panel.rows * panel.columns * views), 4),
                "problems": recording.problems,
            }
        )
    )


if __name__ == "__main__":
    main()
