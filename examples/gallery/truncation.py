"""
A part that is larger than the grid
===================================

What lies around the grid spoils its edge. ``surroundings`` removes it.
"""

from twinct import load_scenario, reconstruct, simulate

BODY = {"shape": {"kind": "cylinder", "radius_mm": 42, "height_mm": 30}, "material": "pmma"}
RODS = [
    {
        "shape": {"kind": "cylinder", "radius_mm": radius, "height_mm": 30},
        "material": "bone",
        "position_mm": [x, y, 0],
    }
    for radius, x, y in ((8, 20, 0), (5, -8, 22), (3, -18, -14), (2, 4, -26))
]
SMALL = {
    "specimen.parts": [BODY, *RODS],
    "xray.engine": "mesh",
    "trajectory.views": 60,
    "detector": {"columns": 88, "rows": 32, "pixel_pitch_mm": 3},
    "reconstruction.grid": {"voxels": [76, 76, 24], "voxel_mm": 1.5},
}

inside = {"reconstruction.grid": {"voxels": [40, 40, 16], "voxel_mm": 1.5}}
scan = simulate(load_scenario("circle_gantry", SMALL | inside))
reconstruct(scan, algorithm="sart", iterations=3).show("truncation_rim.png")

# %%
# Without the surroundings
# ------------------------

around = {"margin_mm": 20, "voxel_mm": 4}
reconstruct(scan, algorithm="sart", iterations=3, surroundings=around).show(
    "truncation_removed.png"
)
