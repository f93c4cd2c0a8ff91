"""
As many views as the part needs
===============================

With ``until``, a scan ends by itself, once twice as many views hardly change the volume.
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
    "detector": {"columns": 88, "rows": 32, "pixel_pitch_mm": 3},
    "reconstruction": {"algorithm": "fast", "grid": {"voxels": [76, 76, 24], "voxel_mm": 1.5}},
}
ENOUGH = {"trajectory.views": 300, "until": {"change_rel": 0.05, "first": 12}}

scan = simulate(load_scenario("circle_gantry", SMALL | ENOUGH))
print(f"{len(scan)} of at most 300 views")
reconstruct(scan).show("enough_views.png")

# %%
# After the first sweep
# ---------------------

reconstruct(scan.of_views(range(12))).show("enough_views_first.png")
