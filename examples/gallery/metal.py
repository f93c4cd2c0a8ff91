"""
Metal
=====

Rods of titanium starve the rays between them. ``nmar`` replaces these rays.
"""

from twinct import load_scenario, reconstruct, simulate

BODY = {"shape": {"kind": "cylinder", "radius_mm": 42, "height_mm": 30}, "material": "pmma"}
RODS = [
    {
        "shape": {"kind": "cylinder", "radius_mm": radius, "height_mm": 30},
        "material": "titanium",
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

tube = {
    "source.spectrum": {"kind": "tube", "kvp": 80},
    "detector.noise": {"kind": "snr", "snr": 100},
}
scan = simulate(load_scenario("circle_gantry", SMALL | tube))
reconstruct(scan, algorithm="fdk").show("metal_streaks.png")

# %%
# The shadows of the metal replaced
# ---------------------------------

metal = {"method": "nmar", "metal": "titanium", "tissue": "pmma"}
reconstruct(scan, algorithm="fdk", metal=metal).show("metal_nmar.png")
