"""
Wrong poses
===========

The volume is made from the poses that the system believes. Errors of 1 mm blur it; the true
poses, which only a simulation knows, show how good it could be.
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
WRONG = {"sigma_mm": 1.0, "cutoff_mm": 3.0}

errors = {"uncertainty": {"source": WRONG, "detector": WRONG}}
scan = simulate(load_scenario("circle_gantry", SMALL | errors))
reconstruct(scan, algorithm="fast").show("wrong_poses_believed.png")

# %%
# From the true poses
# -------------------

reconstruct(scan, algorithm="fast", geometry="executed").show("wrong_poses_executed.png")
