"""How sharp two thin wires among bone are, from the executed, the believed and the found geometry.

    python benchmarks/bench_wires.py [--seeds 1 2 3] [--out DIR]    (half an hour a seed)

Two tungsten wires of 0.2 mm lie across each other in the great opening of the built-in skull's
base, 6 mm apart, one along x, one along y; the paper's path, 200 views of 640 x 480 pixels of
0.5 mm, 4 x 4 samples, no noise. Source and panel are off by sigma 0.15 mm along each axis, each
view on its own; turns are believed as they are. The scan calibrates itself with the wires' traces
masked, on 512^3 voxels of 0.4 mm: they may not help. Then a zoom of 0.1 mm voxels about them is
made by SART from each geometry, what is found and what is believed moved as a whole to where the
executed lies. FWHM is of the cut through the wire's mean profile over 6 mm of it, along both axes
across it. One JSON line a seed in DIR, and a picture of each.
"""

from __future__ import annotations

import argparse
import json
import pickle
import time
from pathlib import Path

import matplotlib as mpl
import numpy as np
from scipy.signal import find_peaks, peak_widths

from twinct.calibration import PosePrior, aligned, moved, self_calibrated
from twinct.geometry import ScanGeometry
from twinct.recon import Projector, sart
from twinct.recon.surroundings import without_surroundings
from twinct.runs import simulate
from twinct.scan import line_integrals
from twinct.scenario import Scenario, parse_scenario
from twinct.uncertainty.correlation import view_normals

mpl.use("Agg")
import matplotlib.pyplot as plt

VIEWS = 200
SIGMA_MM, SIGMA_DEG = 0.15, 0.01
"""The latter is what the prior says of turns, which are not off: small, as it must not be 0."""

LENGTH_MM, RADIUS_MM = 16.0, 0.1
MIDDLES = {"x": (0.0, -22.0, -20.0), "y": (0.0, -22.0, -14.0)}
TURNS = {"x": (0.0, 90.0, 0.0), "y": (90.0, 0.0, 0.0)}
MASKED_MM = 1.5
"""Pixels whose centres lie as near to a wire's believed trace do not count."""

SHOWN_MM = 1.5
"""Of the picture, to each side."""

ALONG_MM, PASSES, RELAXATION = 6.0, 5, 0.3


def scenario_of() -> Scenario:
    """The scan of all seeds."""
    wires = [
        {
            "name": f"wire along {axis}",
            "shape": {"kind": "cylinder", "radius_mm": RADIUS_MM, "height_mm": LENGTH_MM},
            "material": "tungsten",
            "position_mm": MIDDLES[axis],
            "rotation_deg": TURNS[axis],
        }
        for axis in MIDDLES
    ]
    return parse_scenario(
        {
            "cell": {"kind": "gantry"},
            "trajectory": {"kind": "sinusoid", "views": VIEWS},
            "detector": {
                "columns": 640,
                "rows": 480,
                "pixel_pitch_mm": 0.5,
                "pixel_samples": 4,
            },
            "specimen": {"parts": [{"shape": {"kind": "skull"}, "material": "bone"}, *wires]},
            "reconstruction": {
                "grid": {"voxels": 256, "voxel_mm": 0.8},
                "zoom": {"centre_mm": (0, -22, -17), "size_mm": (10, 10, 14), "voxel_mm": 0.1},
            },
        }
    )


def scanned(scenario: Scenario, kept: Path):
    """Line integrals and executed geometry; made once."""
    if kept.exists():
        return pickle.loads(kept.read_bytes())
    scan = simulate(scenario)
    executed = scan.executed.geometry(scenario.detector.panel)
    told = line_integrals(scan.transmission), executed
    kept.write_bytes(pickle.dumps(told))
    return told


def beside_the_wires(geometry: ScanGeometry) -> np.ndarray:
    """Pixels that no wire's trace comes near, (views, rows, columns)."""
    panel = geometry.panel
    along = np.linspace(-LENGTH_MM / 2, LENGTH_MM / 2, 161)
    counts = np.ones((len(geometry), *panel.shape), bool)
    reach = int(np.ceil(MASKED_MM / panel.pitch_u))
    steps = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1)
    steps = steps[:, np.hypot(*steps) * panel.pitch_u <= MASKED_MM]
    for axis, middle in MIDDLES.items():
        points = np.array(middle) + along[:, None] * np.eye(3)["xyz".index(axis)]
        for view, pixels in enumerate(np.round(geometry.project(points)).astype(int)):
            column, row = (pixels[:, k, None] + steps[1 - k] for k in (0, 1))
            inside = (column >= 0) & (column < panel.columns) & (row >= 0) & (row < panel.rows)
            counts[view, row[inside], column[inside]] = False
    return counts


def wires(geometry, p, scenario) -> np.ndarray:
    """The zoom from a geometry."""
    section = scenario.reconstruction
    A = Projector(geometry, section.volume_grid)
    rest = without_surroundings(A, p, **section.around._asdict())
    return sart(A, rest, iterations=PASSES, relaxation=RELAXATION, nonnegative=True).array


def profiles(x: np.ndarray, grid) -> dict[str, np.ndarray]:
    """Of each wire, averaged along it: the plane across it, lower axis of x, y, z first."""
    found = {}
    for axis, middle in MIDDLES.items():
        low = grid.world_from_grid.position - grid.size_mm / 2
        place = (np.array(middle) - low) / grid.voxel - 0.5
        own = "xyz".index(axis)
        reach = (np.array([2.5, 2.5, 2.5]) / grid.voxel).astype(int)
        reach[own] = int(ALONG_MM / 2 / grid.voxel[own])
        first = np.round(place).astype(int) - reach
        cut = tuple(slice(a, a + 2 * r + 1) for a, r in zip(first, reach, strict=True))
        found[axis] = x.transpose(2, 1, 0)[cut].mean(axis=own)
    return found


def fwhm_mm(cut: np.ndarray, voxel_mm: float) -> float:
    """Full width at half of the height above the background, of the highest peak."""
    cut = np.asarray(cut, np.float64)
    peaks, _ = find_peaks(cut)
    highest = peaks[[cut[peaks].argmax()]]
    ground = np.median(np.concatenate([cut[:10], cut[-10:]]))
    # Prominence is counted from the background, not from the streaks beside the wire.
    height = cut[highest] - ground
    data = height, np.array([0]), np.array([len(cut) - 1])
    return float(peak_widths(cut, highest, 0.5, data)[0][0] * voxel_mm)


def widths(planes: dict[str, np.ndarray], voxel_mm: float) -> dict[str, float]:
    """Of each wire along both axes across it."""
    told = {}
    for axis, plane in planes.items():
        across = [one for one in "xyz" if one != axis]
        peak = np.unravel_index(plane.argmax(), plane.shape)
        for which, other in enumerate(across):
            cut = plane[:, peak[1]] if which == 0 else plane[peak[0]]
            told[f"along {axis}, {other}"] = fwhm_mm(cut, voxel_mm)
    return told


def picture(found: dict[str, dict[str, np.ndarray]], voxel_mm: float, file: Path) -> None:
    """Planes across both wires, the same window for all."""
    figure, axes = plt.subplots(2, len(found), figsize=(3 * len(found), 6), squeeze=False)
    for row, axis in zip(axes, MIDDLES, strict=True):
        top = max(float(planes[axis].max()) for planes in found.values())
        across = [one for one in "xyz" if one != axis]
        for panel, (name, planes) in zip(row, found.items(), strict=True):
            half = voxel_mm * planes[axis].shape[0] / 2
            shown = {"cmap": "gray", "vmin": 0, "vmax": top, "origin": "lower"}
            image = panel.imshow(planes[axis].T, extent=[-half, half, -half, half], **shown)
            panel.set(title=f"{name}, along {axis}", xlabel=f"{across[0]} (mm)")
            panel.set(ylabel=f"{across[1]} (mm)", xlim=(-SHOWN_MM, SHOWN_MM))
            panel.set_ylim(-SHOWN_MM, SHOWN_MM)
            figure.colorbar(image, ax=panel, label="attenuation (1/mm)", shrink=0.7)
    figure.tight_layout()
    figure.savefig(file, dpi=120)
    plt.close(figure)


def main() -> None:
    """Each seed that is not there yet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", nargs="+", type=int, default=(1, 2, 3))
    parser.add_argument("--out", type=Path, default=Path("out/wires"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    scenario = scenario_of()
    p, executed = scanned(scenario, options.out / "scan.pkl")
    whole, zoom = scenario.reconstruction.grid, scenario.reconstruction.volume_grid
    fine = whole.model_copy(update={"voxels": 512, "voxel_mm": 0.4}).volume_grid
    voxel_mm = float(zoom.voxel[0])
    points = np.array(list(MIDDLES.values()) + [(30, 0, 0), (-30, 0, 0), (0, 30, 10), (0, 0, 40)])
    lines = options.out / "wires.jsonl"
    told = [json.loads(line) for line in lines.read_text().splitlines()] if lines.exists() else []
    sharp = options.out / "executed.npy"
    if not sharp.exists():
        np.save(sharp, wires(executed, p, scenario))
    kept = {"executed": profiles(np.load(sharp), zoom)}
    best = widths(kept["executed"], voxel_mm)
    print(json.dumps({"executed": {key: round(value, 3) for key, value in best.items()}}))
    for seed in options.seeds:
        if any(one["seed"] == seed for one in told):
            continue
        sigma = np.array([SIGMA_MM] * 6 + [0.0] * 3)
        normals = [view_normals(seed, "wires", view, 9, 0.0) for view in range(VIEWS)]
        believed = moved(executed, sigma * np.array(normals))
        start = time.perf_counter()
        counts = beside_the_wires(believed)
        found = self_calibrated(p, believed, fine, PosePrior(SIGMA_MM, SIGMA_DEG), mask=counts)
        case: dict = {
            "seed": seed,
            "seconds": round(time.perf_counter() - start),
            "masked": round(float(1 - counts.mean()), 4),
        }
        planes = dict(kept)
        for name, geometry in (("believed", believed), ("found", found.geometry)):
            there = aligned(geometry, executed, points)
            planes[name] = profiles(wires(there.geometry, p, scenario), zoom)
            case[f"{name} px"] = round(there.after_px, 4)
            case[name] = {k: round(v, 3) for k, v in widths(planes[name], voxel_mm).items()}
            case[f"{name} ratio"] = {k: round(v / best[k], 3) for k, v in case[name].items()}
        picture(planes, voxel_mm, options.out / f"wires{seed}.png")
        with lines.open("a") as stream:
            stream.write(json.dumps(case) + "\n")
        print(json.dumps(case), flush=True)


if __name__ == "__main__":
    main()
