"""Density of metal that NMAR puts back: balls and screws of 2 to 8 mm in soft tissue.

    python benchmarks/bench_metal_density.py [--seeds 1 2 3 4 5] [--metals titanium steel]

Each scan holds four balls, or four cylinders 16 mm long, at places drawn from the seed, in an
ellipsoid of tissue with a ball of bone: 120 kVp, 90 views on a circle, quantum noise of about 1e5
photons a pixel, voxels of 1 mm, 5 passes of SART. A density is the mean of the voxels that lie in
the metal, relative to the metal's attenuation at the mean energy; where no voxel does, the mean of
the four that hold the most metal, relative to their truth. The last column is what ``metrics.json``
says: the density of voxels within metal, and the number of those too thin for one.
"""

from __future__ import annotations

import argparse

import numpy as np

from twinct import reconstruct, simulate
from twinct.scenario import Scenario, parse_scenario
from twinct.specimen import build_specimen, volume_fractions
from twinct.xray.build import effective_energy_kev

SIZES_MM = (2, 4, 6, 8)
WHOLE = 0.999
"""Share of metal from which a voxel counts as inside."""


def scenario(metal: str, shape: str, seed: int) -> Scenario:
    rng = np.random.default_rng([seed, len(metal), len(shape)])
    corners = np.array([(-18, -12, -9), (18, -12, 8), (-15, 10, 9), (15, 9, -9)])
    tissue = {"kind": "ellipsoid", "semi_axes_mm": [40, 36, 30], "mesh_resolution_mm": 1.5}
    bone = {"kind": "sphere", "radius_mm": 6, "mesh_resolution_mm": 0.8}
    parts = [
        {"name": "body", "material": "soft_tissue", "shape": tissue},
        {"name": "bone", "material": "bone", "position_mm": [0, 24, 0], "shape": bone},
    ]
    for size, corner in zip(SIZES_MM, corners, strict=True):
        body = {"kind": shape, "radius_mm": size / 2}
        body |= {"mesh_resolution_mm": size / 20} if shape == "sphere" else {"height_mm": 16}
        placed = {
            "position_mm": (corner + rng.uniform(-2, 2, 3)).tolist(),
            "rotation_deg": rng.uniform(0, 360, 3).tolist(),
        }
        parts.append({"name": f"{size} mm", "material": metal, "shape": body} | placed)
    return parse_scenario(
        {
            "seed": seed,
            "cell": {"kind": "gantry"},
            "xray": {"engine": "mesh"},
            "source": {"spectrum": {"kind": "tube", "kvp": 120}, "photons_per_mm2_mas": 3.6e6},
            "detector": {
                "columns": 200,
                "rows": 160,
                "pixel_pitch_mm": 1.0,
                "noise": {"kind": "quantum"},
            },
            "trajectory": {"kind": "circle", "views": 90, "sod_mm": 300, "sdd_mm": 600},
            "specimen": {"parts": parts},
            "reconstruction": {
                "algorithm": "sart",
                "iterations": 5,
                "grid": {"voxels": [96, 88, 76], "voxel_mm": 1.0},
                "metal": {"method": "nmar", "metal": metal},
            },
        }
    )


def densities(given: Scenario) -> tuple[list[float], object]:
    volume = reconstruct(simulate(given))
    specimen = build_specimen(given.specimen)
    energy = effective_energy_kev(given.source, given.detector)
    found = []
    for part in specimen.parts[2:]:
        mesh, pose = part.mesh, specimen.world_from_specimen
        share = volume_fractions(mesh.vertices, mesh.faces, volume.grid, pose)
        core = share >= min(WHOLE, float(np.sort(share, axis=None)[-4]))
        truth = part.material.mu_per_mm(energy) * share[core].mean()
        found.append(float(volume.array[core].mean() / truth))
    said = [volume.extras.get(key) for key in ("metal_density_rel", "metal_thin_voxels")]
    return found, "density {}, {} thin voxels".format(*said)


def main() -> None:
    parser = argparse.ArgumentParser(description="Density of metal that NMAR puts back.")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3, 4, 5])
    parser.add_argument("--metals", nargs="+", default=["titanium", "steel"])
    asked = parser.parse_args()
    print(
        f"{'metal':10}{'shape':10}{'seed':>5}" + "".join(f"{s:>7} mm" for s in SIZES_MM) + "  said"
    )
    for metal in asked.metals:
        for shape in ("sphere", "cylinder"):
            for seed in asked.seeds:
                found, said = densities(scenario(metal, shape, seed))
                cells = "".join(f"{value:10.2f}" for value in found)
                print(f"{metal:10}{shape:10}{seed:5}{cells}  {said}", flush=True)


if __name__ == "__main__":
    main()
