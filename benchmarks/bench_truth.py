"""Seconds of the voxel truth of a mesh at full size: 512^3 voxels, 328,000 triangles.

    python benchmarks/bench_truth.py

Exit code 1 above ``--most`` seconds (45; 2 quiet cores take a few).
"""

from __future__ import annotations

import argparse
import sys
import time

import trimesh

from twinct.geometry import Pose, VolumeGrid
from twinct.specimen.voxels import volume_fractions


def main() -> int:
    """Voxelise a ball three times; the fastest counts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--most", type=float, default=45.0, help="largest time in seconds")
    most, seconds = parser.parse_args().most, []
    ball = trimesh.creation.icosphere(subdivisions=7, radius=75.0)
    grid = VolumeGrid((512, 512, 512), 0.31)
    for _ in range(3):
        before = time.perf_counter()
        volume_fractions(ball.vertices, ball.faces, grid, Pose.identity())
        seconds.append(time.perf_counter() - before)
    print(f"{len(ball.faces)} triangles: {min(seconds):.1f} s")
    return 1 if min(seconds) > most else 0


if __name__ == "__main__":
    sys.exit(main())
