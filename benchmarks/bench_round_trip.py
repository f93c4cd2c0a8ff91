"""Every export of twinct, imported again: images, and the movement of object points on the panel.

    python benchmarks/bench_round_trip.py

40 free views around a shifted and turned grid, panels tilted up to 30 degrees, 200 points in the
grid; transmissions and line integrals drawn at random. One line for each format.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from twinct.exchange import Bundle, formats, write_bundle
from twinct.geometry import Panel, Pose, ScanGeometry, VolumeGrid
from twinct.measured import description_of, import_measured
from twinct.runs import load_scan

PANEL = Panel(31, 37, 2.3, 1.9)
GRID = VolumeGrid((20, 26, 24), (2.0, 2.0, 2.6), Pose.from_euler((9, -6, 4), (20, -30, 50)))
VIEWS = 40


def free_views(rng: np.random.Generator) -> ScanGeometry:
    """Return views from anywhere around the grid, with tilted and displaced panels."""
    turn = Rotation.random(VIEWS, rng)
    tilt = Rotation.from_rotvec(rng.uniform(-0.3, 0.3, (VIEWS, 3)))
    source = turn.apply([0.0, 0.0, 300.0]) + rng.normal(0, 5, (VIEWS, 3))
    panel = turn.apply([0.0, 0.0, -290.0]) + rng.normal(0, 5, (VIEWS, 3))
    axes = (turn * tilt).as_matrix()
    return ScanGeometry(source, panel, axes[:, :, 0], axes[:, :, 1], PANEL)


def main() -> None:
    rng = np.random.default_rng(0)
    views = GRID.world_from_grid @ free_views(rng)
    half = GRID.size_mm / 2
    points = rng.uniform(-half, half, (200, 3))
    images = rng.uniform(0.001, 1.2, (VIEWS, *PANEL.shape)).astype(np.float32)
    for name in formats():
        told = [f"{name}:"]
        for values in ("transmission", "line-integrals"):
            with tempfile.TemporaryDirectory() as scratch:
                folder = Path(scratch)
                bundle = Bundle(views, GRID, iter(images), values, {"scan": "free"})
                write_bundle(folder / "export", name, bundle)
                import_measured(description_of(folder / "export"), folder / "again")
                scan = load_scan(folder / "again")
                moved = scan.geometry().project(points) - bundle.local.project(points)
                found = scan.transmission if values == "transmission" else scan.line_integrals()
                off = float(np.abs(found - images).max())
                told.append(f"{values} {'equal to the bit' if off == 0 else f'within {off:.1e}'},")
        print(*told, f"points moved by {np.abs(moved).max():.1e} px at most")


if __name__ == "__main__":
    main()
