"""SART of an older checkout against this one, in pairs, each in a process of its own that stays.

python benchmarks/bench_sart_pairs.py OLDER_CHECKOUT --pairs 20

One run of a pair is a pass over some views of the paper's trajectory at 320 x 240 pixels and 256^3
voxels; which of the two goes first alternates. Printed: the median over the pairs of new / old, and
a 95 % interval from a bootstrap over the pairs, of wall time and of processor time (which other
work on the machine disturbs less); and whether the volumes have the same bytes.
"""

import argparse
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

HERE = Path(__file__).resolve().parents[1]
SEED = 0
DRAWS = 10_000

RUNNER = """
import hashlib, sys, time
import numpy as np
from twinct.geometry import Panel, ScanGeometry, VolumeGrid
from twinct.recon import Projector, sart
size, views = int(sys.argv[1]), int(sys.argv[2])
path = np.linspace(0, 1, views, endpoint=False)
lon, lat = np.radians(210) * path, np.radians(30) * np.sin(2 * np.pi * path)
d = np.stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)], 1)
u = np.stack([-np.sin(lon), np.cos(lon), 0 * lon], 1)
scale = size / 512
panel = Panel(int(480 * scale), int(640 * scale), 0.5 / scale, 0.5 / scale)
geometry = ScanGeometry(300 * d, -300 * d, u, np.cross(d, u), panel)
A = Projector(geometry, VolumeGrid((size,) * 3, 0.31 / scale))
p = np.random.default_rng(0).random(A.range_shape, dtype=np.float32)
sart(A, p, iterations=1, relaxation=0.3)
print("ready", flush=True)
for line in sys.stdin:
    wall, processor = time.perf_counter(), time.process_time()
    x = np.asarray(sart(A, p, iterations=1, relaxation=0.3))
    wall, processor = time.perf_counter() - wall, time.process_time() - processor
    print(wall, processor, hashlib.sha256(x.tobytes()).hexdigest(), flush=True)
"""


class Runner:
    """A checkout in a process that waits to be told."""

    def __init__(self, checkout, size, views):
        self.process = subprocess.Popen(
            [sys.executable, "-c", RUNNER, str(size), str(views)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONPATH": str(Path(checkout) / "src")},
        )
        assert self.process.stdin is not None and self.process.stdout is not None
        self.told, self.heard = self.process.stdin, self.process.stdout
        if self.heard.readline() != "ready\n":
            sys.exit(f"{checkout} does not run")

    def run(self):
        """Wall seconds, processor seconds, digest of the volume."""
        self.told.write("go\n")
        self.told.flush()
        wall, processor, digest = self.heard.readline().split()
        return float(wall), float(processor), digest

    def close(self):
        self.told.close()
        self.process.wait()


def interval(ratios):
    """Median, and its 95 % interval."""
    rng = np.random.default_rng(SEED)
    drawn = np.median(rng.choice(ratios, (DRAWS, len(ratios))), axis=1)
    return np.median(ratios), *np.percentile(drawn, (2.5, 97.5))


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("older", type=Path, help="the older checkout")
    parser.add_argument("--pairs", type=int, default=20)
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--views", type=int, default=40)
    options = parser.parse_args()
    old, new = (Runner(place, options.size, options.views) for place in (options.older, HERE))
    ratios, digests = [], set()
    for pair in range(options.pairs):
        results = {}
        for runner in (old, new) if pair % 2 else (new, old):
            results[runner] = runner.run()
        ratios.append([results[new][n] / results[old][n] for n in (0, 1)])
        digests |= {results[old][2], results[new][2]}
        print(f"pair {pair + 1}: {ratios[-1][0]:.3f} wall, {ratios[-1][1]:.3f} cpu", flush=True)
    for name, values in zip(("wall", "processor"), np.transpose(ratios), strict=True):
        middle, low, high = interval(values)
        print(f"{name} time, new / old: median {middle:.4f}, 95 % interval {low:.4f} to {high:.4f}")
    print("the volumes have the same bytes" if len(digests) == 1 else "the volumes differ")
    old.close()
    new.close()


if __name__ == "__main__":
    main()
