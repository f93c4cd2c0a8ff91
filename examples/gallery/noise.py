"""
Few and many photons
====================

The tube load decides the noise: one part with 0.05 and with 5 mAs for each view.
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
NOISY = {
    "source": {
        "spectrum": {"kind": "tube", "kvp": 80},
        "current_ma": 5,
        "exposure_ms": 10,
    },
    "detector.noise": {"kind": "quantum"},
}

few = simulate(load_scenario("circle_gantry", SMALL | NOISY))
reconstruct(few, algorithm="fdk").show("noise_few_photons.png")

# %%
# A hundred times the load
# ------------------------

many = simulate(load_scenario("circle_gantry", SMALL | NOISY | {"source.current_ma": 500}))
reconstruct(many, algorithm="fdk").show("noise_many_photons.png")
