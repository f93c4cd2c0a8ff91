"""
Few views
=========

Twenty views leave streaks with ``fdk``; total variation finds the part behind them.
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

scan = simulate(load_scenario("circle_gantry", SMALL | {"trajectory.views": 20}))
reconstruct(scan, algorithm="fdk").show("few_views_fdk.png")

# %%
# With total variation
# --------------------

reconstruct(scan, algorithm="fista_tv").show("few_views_tv.png")
