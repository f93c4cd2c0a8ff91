"""Draw docs/images/algorithms.png and truncation.png: the demo's skull from every algorithm.

    python docs/pictures/algorithms.py

gVXR renders the projections from the commanded poses. The first picture has Poisson noise of 1e4
photons per pixel; there, fdk uses an arc with the same number of views.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from twinct.evaluation import image_figures, region_of_interest
from twinct.geometry import ScanGeometry
from twinct.recon import (
    Projector,
    cgls,
    fast,
    fdk,
    os_sart,
    sart,
    sirt,
    without_surroundings,
)
from twinct.recon.fista_tv import PASSES, TOLERANCE
from twinct.recon.volume import Volume
from twinct.scan import SimulationBuilder
from twinct.scenario import load_scenario
from twinct.trajectory import commanded_views

ROOT = Path(__file__).parents[2]
IMAGES = ROOT / "docs" / "images"
PHOTONS, SEED = 1e4, 1
ARC = "trajectory={kind: arc, views: 100, longitude_range_deg: 212}"
ALGORITHMS: dict[str, Callable[..., Volume]] = {
    "sart, 5 iterations of 0.3": lambda A, p: sart(
        A, p, iterations=5, relaxation=0.3, nonnegative=True
    ),
    "fast": lambda A, p: fast(A, p),
    "os_sart, 10 subsets,\n12 iterations of 1": lambda A, p: os_sart(
        A, p, iterations=12, relaxation=1.0, nonnegative=True
    ),
    "sirt, 80 iterations": lambda A, p: sirt(A, p, iterations=80, nonnegative=True),
    "cgls, 10 iterations": lambda A, p: cgls(A, p, iterations=10),
    "fista_tv": lambda A, p: fast(A, p, passes=PASSES, tolerance=TOLERANCE),
}

demo = load_scenario(ROOT / "scenarios" / "demo.yaml")
builder = SimulationBuilder(demo)
grid = demo.reconstruction.grid.volume_grid
energy = demo.source.energy_kev
truth = builder.specimen.truth(grid, energy)
mu = builder.specimen.reference_mu(energy)


def line_integrals(geometry: ScanGeometry, noisy: bool = True) -> np.ndarray:
    """Return the line integrals of the skull, with Poisson noise unless ``noisy`` is False."""
    stand = builder.specimen.world_from_specimen
    with builder.imager() as imager:
        transmission = np.stack([imager.render(view, stand) for view in geometry])
    if not noisy:
        return -np.log(transmission)
    counts = np.random.default_rng(SEED).poisson(transmission * PHOTONS)
    return -np.log(np.maximum(counts, 1) / PHOTONS).astype(np.float32)


def near_bone(volume: np.ndarray, geometry: ScanGeometry) -> tuple[float, float]:
    """Return the RMSE within 3 mm of bone and in the region, % of mu(bone)."""
    figures = image_figures(volume, truth, region_of_interest(geometry, grid), mu, grid)
    return 100 * figures.rmse_near_rel, 100 * figures.rmse_rel


Panels = dict[str, tuple[np.ndarray, np.ndarray]]
"""Volume and region of interest by title."""


def draw(path: Path, panels: Panels, columns: int) -> None:
    """Draw sagittal slices in one grey window, with the outline of the region of interest."""
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(2.5 * columns, 2.95 * rows), layout="constrained", dpi=110)
    middle = grid.shape[2] // 2 + 6
    half = grid.size_mm[1] / 2, grid.size_mm[2] / 2
    extent = (-half[0], half[0], -half[1], half[1])
    grid_of_axes = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    for axes, (title, (volume, region)) in zip(grid_of_axes.flat, panels.items(), strict=False):
        axes.imshow(
            volume[:, :, middle], cmap="gray", vmin=0, vmax=1.15 * mu, origin="lower", extent=extent
        )
        axes.contour(region[:, :, middle], levels=[0.5], colors="#f2a33a", extent=extent)
        axes.set_title(title, fontsize=9)
    for axes in grid_of_axes[-1]:
        axes.set_xlabel("y, mm")
    for axes in grid_of_axes[:, 0]:
        axes.set_ylabel("z, mm")
    figure.savefig(path, metadata={"Software": None})


def main() -> None:
    """Reconstruct with each algorithm, print the errors and draw both pictures."""
    geometry = builder.commanded
    region = region_of_interest(geometry, grid)
    p, A = line_integrals(geometry), Projector(geometry, grid)
    panels: Panels = {"truth": (truth, region)}

    def keep(name: str, volume: Volume, views: ScanGeometry) -> None:
        near, all_over = near_bone(volume.array, views)
        sys.stdout.write(f"{name!r}: {near:.1f} % near bone, {all_over:.1f} % in the region\n")
        panels[f"{name}: {near:.1f} %"] = volume.array, region_of_interest(views, grid)

    for name, run in ALGORITHMS.items():
        keep(name, run(A, p), geometry)
    rest = without_surroundings(A, p, margin_mm=50.0, voxel_mm=2.5)
    alone = fast(A, rest, margin=0.0)
    keep("fast,\nsurroundings taken out", alone, geometry)
    arc = commanded_views(
        load_scenario(ROOT / "scenarios" / "demo.yaml", [ARC]).trajectory, demo.detector.panel
    )
    filtered = fdk(Projector(arc, grid), line_integrals(arc), window="hann", nonnegative=True)
    keep("fdk, hann,\non an arc of 212 deg", filtered, arc)
    draw(IMAGES / "algorithms.png", panels, 3)

    panels = {"truth": (truth, region)}
    p = line_integrals(geometry, noisy=False)
    rest = without_surroundings(A, p, margin_mm=50.0, voxel_mm=2.5)
    for name, data in (("sart", p), ("surroundings taken out", rest)):
        keep(name, sart(A, data, iterations=10, relaxation=0.3), geometry)
    draw(IMAGES / "truncation.png", panels, 3)


if __name__ == "__main__":
    main()
