"""Draw docs/images/trajectories.png: source positions of each family of trajectories.

python docs/pictures/trajectories.py
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from pydantic import TypeAdapter

from twinct.geometry import Panel
from twinct.scenario import AnyTrajectory
from twinct.trajectory import commanded_views

PICTURE = Path(__file__).parents[2] / "docs" / "images" / "trajectories.png"
PANEL = Panel(480, 640, 0.5, 0.5)
SHOWN: dict[str, dict[str, Any]] = {
    "sinusoid": {},
    "sinusoid, two turns": {"longitude_range_deg": 720, "periods": 3},
    "arc": {"latitude_deg": 20},
    "arc, tilted": {"tilt_deg": 30},
    "circle, sod_mm: [250, 350, 250]": {"sod_mm": [250, 350, 250]},
    "circle_arc": {"views": 120, "arc_latitude_deg": 60},
    "saddle": {},
    "spiral": {"views": 200},
    "uniform": {"views": 200},
    "helix": {},
}


def main() -> None:
    """Draw each trajectory as points on its sphere, coloured by view."""
    figure = Figure(figsize=(12, 5.4), layout="constrained")
    dots = None
    for place, (title, keys) in enumerate(SHOWN.items(), 1):
        kind = title.partition(",")[0]
        section = TypeAdapter(AnyTrajectory).validate_python({"views": 100, **keys, "kind": kind})
        source = commanded_views(section, PANEL).source
        axes: Any = figure.add_subplot(2, 5, place, projection="3d")
        longitude = np.linspace(0, 2 * np.pi, 121)
        for latitude in np.radians([-60, -30, 0, 30, 60]):
            ring = 300 * np.cos(latitude) * np.stack([np.cos(longitude), np.sin(longitude)])
            axes.plot(*ring, 300 * np.sin(latitude), color="0.85", lw=0.6)
        dots = axes.scatter(*source.T, c=np.arange(len(source)), cmap="viridis", s=5)
        axes.set(xlim=(-300, 300), ylim=(-300, 300), zlim=(-300, 300))
        axes.set_box_aspect((1, 1, 1), zoom=1.45)
        axes.view_init(22, 35)
        axes.set_axis_off()
        axes.set_title(title, fontsize=9, y=1.0)
    assert dots is not None, "something is shown"
    bar = figure.colorbar(dots, ax=figure.axes, shrink=0.5, pad=0.01, ticks=[0, 99])
    bar.ax.set_yticklabels(["first view", "last"], fontsize=8)
    figure.savefig(PICTURE, dpi=110)
    print(f"wrote {PICTURE.name}")


if __name__ == "__main__":
    main()
