"""
Thin walls
==========

Shells of 1 mm, in voxels of 1.5 mm: the volume blurs what is thinner than its voxels.
"""

from twinct import load_scenario, reconstruct, simulate

SHELLS = [
    {"shape": {"kind": "sphere", "radius_mm": radius}, "material": material}
    for radius, material in ((40, "pmma"), (39, "air"), (25, "pmma"), (24, "air"), (10, "pmma"))
]
SMALL = {
    "specimen.parts": SHELLS,
    "xray.engine": "mesh",
    "trajectory.views": 60,
    "detector": {"columns": 88, "rows": 64, "pixel_pitch_mm": 3},
    "reconstruction.grid": {"voxels": 60, "voxel_mm": 1.5},
}
scan = simulate(load_scenario("circle_gantry", SMALL))
reconstruct(scan, algorithm="fdk").show("shells.png")
