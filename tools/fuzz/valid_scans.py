"""Small finished scans: recorded ones of a gantry and of planned arms, and two of version 0.1."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
SMALL = (
    *("trajectory.views=3", "reconstruction.grid={voxels: 12, voxel_mm: 12}"),
    *("specimen.parts=[{shape: {kind: sphere, radius_mm: 50}}]", "reconstruction.iterations=1"),
    "xray.engine=mesh",  # gVXR takes two seconds to load
)
SCANS = {
    "gantry": (
        "circle_gantry.yaml",
        "detector={columns: 16, rows: 12, pixel_pitch_mm: 20, readout: {}, "
        "bad_pixels: {kind: random, share: 0.02}}",
    ),
    "arms": ("demo.yaml", "detector={columns: 16, rows: 12, pixel_pitch_mm: 20}"),
}
OLD = {"old": "local", "older": "ros2"}
"""Scans of version 0.1, which had no digests."""


def make_scans(folder: Path, *more: str) -> None:
    """Make the missing scans, each in its own folder; ``more`` keys apply to the gantry."""
    for name, (scenario, *keys) in SCANS.items():
        out = folder / name
        if (out / "report.html").exists():  # written last
            continue
        shutil.rmtree(out, ignore_errors=True)
        command = [sys.executable, "-m", "twinct", "run", str(ROOT / "scenarios" / scenario)]
        command += ["--out", str(out), "--link", "local", "--record"]
        keys += more if name == "gantry" else ()
        # In a separate process, since gVXR retains more memory than a case may use.
        subprocess.run(
            [*command, *(part for key in (*SMALL, *keys) for part in ("--set", key))], check=True
        )
    for name, link in OLD.items():
        shutil.unpack_archive(ROOT / "tests" / "version_0_1" / f"{link}.tar.xz", folder / name)
