"""
Beam hardening
==============

A tube makes a uniform part look darker in the middle. ``one_material`` linearises the line
integrals.
"""

from twinct import load_scenario, reconstruct, simulate

BODY = {"shape": {"kind": "cylinder", "radius_mm": 42, "height_mm": 30}, "material": "pmma"}
RODS = [
    {
        "shape": {"kind": "cylinder", "radius_mm": radius, "height_mm": 30},
        "material": "air",
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

tube = {"source.spectrum": {"kind": "tube", "kvp": 60}}
scan = simulate(load_scenario("circle_gantry", SMALL | tube))
reconstruct(scan, algorithm="fdk").show("beam_hardening_cup.png")

# %%
# Corrected
# ---------

even = reconstruct(scan, algorithm="fdk", beam_hardening={"kind": "one_material"})
even.show("beam_hardening_corrected.png")
