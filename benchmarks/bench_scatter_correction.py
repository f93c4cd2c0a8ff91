"""Soft tissue of a head at 120 kVp without a grid: error in HU that scatter leaves.

    python benchmarks/bench_scatter_correction.py [--views 90] [--photons 8e5] [--rounds 2]

The built-in head of voxels, a circle of 600 and 1000 mm, a panel of 400 x 300 mm, caesium iodide.
Its scan with scatter by Monte Carlo is reconstructed as it is, and after the correction, which
knows beam and panel but not the head. Both are compared with the volume of a scan without scatter:
root mean square over the voxels of soft tissue, 3 mm and more from anything else, in HU by the
attenuation of water. ``left`` is the error after the correction, relative to that before; asked are
20 %. Cupping is the mean error within 30 mm of the axis minus that beyond 60 mm.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
import scipy.ndimage

from twinct import simulate
from twinct.core.threads import let_idle_threads_sleep
from twinct.runs import reconstruct
from twinct.scenario import parse_scenario
from twinct.specimen import build_specimen
from twinct.specimen.materials import material
from twinct.xray.build import effective_energy_kev

SCENARIO: dict[str, Any] = {
    "name": "head",
    "cell": {"kind": "gantry"},
    "trajectory": {"kind": "circle", "sod_mm": 600, "sdd_mm": 1000},
    "detector": {
        "rows": 120,
        "columns": 160,
        "pixel_pitch_mm": 2.5,
        "response": {"kind": "scintillator", "material": "CsI", "thickness_mm": 0.6},
    },
    "source": {
        "spectrum": {
            "kind": "tube",
            "kvp": 120,
            "filters": [{"material": "aluminium", "thickness_mm": 5}],
        }
    },
    "specimen": {"parts": [{"name": "head", "shape": {"kind": "volume", "phantom": "head"}}]},
    "reconstruction": {
        "algorithm": "fast",
        "beam_hardening": {"kind": "two_materials"},
        "grid": {"voxels": 100, "voxel_mm": 2.4},
    },
}

CORRECTION_PHOTONS = 200_000


def main() -> None:
    """Simulate, correct and compare."""
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n", maxsplit=1)[0])
    parser.add_argument("--views", type=int, default=90)
    parser.add_argument("--photons", type=float, default=8e5)
    parser.add_argument("--rounds", type=int, nargs="+", default=[2])
    given = parser.parse_args()
    let_idle_threads_sleep()
    plain = SCENARIO | {"trajectory": SCENARIO["trajectory"] | {"views": given.views}}
    scatter = {"kind": "monte_carlo", "photons": int(given.photons), "pixel_mm": 30}
    scattered = plain | {"detector": plain["detector"] | {"scatter": scatter}}
    clean = simulate(parse_scenario(plain))
    scan = simulate(parse_scenario(scattered))
    share = 1 - clean.transmission / scan.transmission
    print(f"scatter of all signal: mean {share.mean():.2f}, most {share.max():.2f}", flush=True)
    primary, before = (reconstruct(one).array for one in (clean, scan))
    soft, radius = tissue(plain)
    water = material("water").mu_per_mm(effective_energy_kev(*beam(plain)))
    error = report("as it is", before, primary, soft, radius, water)
    for rounds in given.rounds:
        keys = {"kind": "monte_carlo", "rounds": rounds, "photons": CORRECTION_PHOTONS}
        after = reconstruct(scan, scatter=keys).array
        left = report(f"{rounds} rounds", after, primary, soft, radius, water)
        print(f"  left: {left / error:.1%}", flush=True)


def beam(told: dict[str, Any]) -> tuple[Any, Any]:
    """Return source and detector."""
    scenario = parse_scenario(told)
    return scenario.source, scenario.detector


def tissue(told: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Return the voxels of soft tissue, and the distance of all voxels from the axis, mm."""
    scenario = parse_scenario(told)
    grid = scenario.reconstruction.volume_grid
    energy = effective_energy_kev(scenario.source, scenario.detector)
    truth = build_specimen(scenario.specimen).truth(grid, energy)
    water = material("water").mu_per_mm(energy)
    soft = abs(np.asarray(truth) / water - 1.03) < 0.05
    soft = scipy.ndimage.binary_erosion(soft, iterations=2)
    x, y, _ = grid.axes()
    return soft, np.broadcast_to(np.hypot(x, y[:, None]), soft.shape)


def report(
    name: str,
    volume: np.ndarray,
    primary: np.ndarray,
    soft: np.ndarray,
    radius: np.ndarray,
    water: float,
) -> float:
    """Print and return the error of a volume, HU."""
    off = 1000 * (volume - primary) / water
    error = float(np.sqrt((off[soft] ** 2).mean()))
    cup = off[soft & (radius < 30)].mean() - off[soft & (radius > 60)].mean()
    mean = off[soft].mean()
    print(f"{name}: {error:.1f} HU, mean {mean:+.1f} HU, cupping {cup:+.1f} HU", flush=True)
    return error


if __name__ == "__main__":
    main()
