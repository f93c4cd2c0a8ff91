"""Draw docs/images/growing.webp: the room and the volume that grows from view to view.

python docs/pictures/growing.py
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from twinct import load_scenario, reconstruct
from twinct.recon import Projector, Step, sart
from twinct.robots.cell import Marks
from twinct.robots.cell.render import PictureContent, room_pictures, whole_camera
from twinct.runs import simulate
from twinct.scan import SimulationBuilder

ROOT = Path(__file__).parents[2]
EVERY = 4
"""Views between two frames."""

WIDTH, HEIGHT, SECTION, MS, END_MS = 480, 360, 360, 120, 2500


def main() -> None:
    """Scan the demo's skull, and draw a frame for each fourth view and one for the result."""
    scenario = load_scenario("demo", {"xray.engine": "mesh"})
    scan = simulate(scenario)
    cell = SimulationBuilder(scenario).cell
    views = scan.geometry("executed")
    sections: list[np.ndarray] = []

    def follow(step: Step) -> None:
        if (step.update + 1) % EVERY == 0:
            sections.append(np.array(_section(step.volume)))

    projector = Projector(scan.geometry("believed"), scenario.reconstruction.volume_grid)
    integrals = scan.line_integrals()
    sart(projector, integrals, iterations=1, relaxation=0.5, order="sequential", callback=follow)
    sections.append(_section(reconstruct(scan, algorithm="fast").array))
    shown = [*range(EVERY - 1, len(views), EVERY), len(views) - 1]
    moments = [PictureContent(scan.joints[one], _beam(views, one)) for one in shown]
    camera = whole_camera(cell, scan.joints[len(views) // 2], WIDTH / HEIGHT)
    rooms = room_pictures(cell, moments, WIDTH, HEIGHT, camera)
    bright = float(np.percentile(sections[-1], 99.8))
    frames = [_frame(room, section, bright) for room, section in zip(rooms, sections, strict=True)]
    times = [MS] * (len(frames) - 1) + [END_MS]
    frames[0].save(
        ROOT / "docs" / "images" / "growing.webp",
        save_all=True,
        append_images=frames[1:],
        duration=times,
        loop=0,
        quality=60,
        method=6,
    )


def _section(array: np.ndarray) -> np.ndarray:
    """Return the middle section across z, the face on top."""
    return array[array.shape[0] // 2, ::-1]


def _beam(views, one: int) -> Marks:
    panel = views.panel
    rows, columns = panel.size_mm[1] / 2, panel.size_mm[0] / 2
    corners = [
        views.detector[one] + i * columns * views.u[one] + j * rows * views.v[one]
        for i in (-1, 1)
        for j in (-1, 1)
    ]
    return Marks(lines=np.array([[views.source[one], corner] for corner in corners]))


def _frame(room: np.ndarray, section: np.ndarray, bright: float) -> Image.Image:
    grey = np.uint8(255 * np.clip(section / bright, 0, 1))
    frame = Image.new("RGB", (WIDTH + SECTION, HEIGHT))
    frame.paste(Image.fromarray(room), (0, 0))
    frame.paste(
        Image.fromarray(grey).resize((SECTION, HEIGHT), Image.Resampling.BICUBIC), (WIDTH, 0)
    )
    return frame


if __name__ == "__main__":
    main()
