"""
Spectrum, noise and detector
============================

An ideal scan has one energy, no noise and point-like pixels. You will add a tube, photons and a
scintillator, see what each does to image and volume, and measure how the noise depends on the tube
load.
"""

# sphinx_gallery_thumbnail_number = 2

# %%
# An ideal scan
# -------------
#
# The phantom is a cylinder of water with rods of PMMA, bone and aluminium, scanned on a gantry.

import matplotlib.pyplot as plt
import numpy as np

from twinct import load_scenario, reconstruct, simulate

rod = {"kind": "cylinder", "radius_mm": 6, "height_mm": 16}
phantom = [
    {
        "name": "body",
        "shape": {"kind": "cylinder", "radius_mm": 40, "height_mm": 20},
        "material": "water",
    },
    {"name": "pmma", "shape": rod, "material": "pmma", "position_mm": [20, 0, 0]},
    {"name": "bone", "shape": rod, "material": "bone", "position_mm": [-12, 18, 0]},
    {"name": "aluminium", "shape": rod, "material": "aluminium", "position_mm": [-12, -18, 0]},
]
ideal = load_scenario(
    "circle_gantry",
    {
        "specimen": {"parts": phantom, "reference": "body"},
        "trajectory.views": 120,
        "detector": {"columns": 120, "rows": 40, "pixel_pitch_mm": 2.0},
        "reconstruction": {
            "algorithm": "sart",
            "iterations": 6,
            "grid": {"voxels": [96, 96, 24], "voxel_mm": 1.0},
        },
    },
)
volume = reconstruct(simulate(ideal))

# %%
# A tube
# ------
#
# ``source.spectrum`` describes a tube by its peak voltage and filters. Soft photons are absorbed
# first, so the beam hardens on its way, and the middle of the cylinder looks less dense. This is
# cupping. ``beam_hardening`` corrects it for water, because the spectrum is known.

tube = {"kind": "tube", "kvp": 80, "filters": [{"material": "aluminium", "thickness_mm": 2.5}]}
polychromatic = simulate(ideal.with_({"source.spectrum": tube}))
hardened = reconstruct(polychromatic)
corrected = reconstruct(polychromatic, beam_hardening={"kind": "one_material", "material": "water"})

x = volume.grid.axes()[0]
row = volume.shape[1] // 2
figure, axis = plt.subplots(figsize=(8, 3.6), layout="constrained")
for name, shown in {"one energy, 80 keV": volume, "tube": hardened, "corrected": corrected}.items():
    axis.plot(x, shown[8:16, row - 3 : row + 4].mean(axis=(0, 1)), label=name)
axis.set(xlabel="x / mm", ylabel="attenuation / mm⁻¹", title="Profile through water and PMMA")
axis.legend()

# %%
# The levels of the curves differ, too: the tube's photons have less energy than 80 keV on average,
# and water attenuates them more. The dark band between bone and aluminium stays, because only one
# material is corrected.
#
# Photons
# -------
#
# With ``noise: {kind: quantum}`` the number of photons matters. For a tube, it follows from
# ``current_ma`` times ``exposure_ms``. The scintillator's response determines the share of photons
# that the detector absorbs.

noisy = ideal.with_(
    {
        "source": {"spectrum": tube, "exposure_ms": 10},
        "detector.noise": {"kind": "quantum"},
        "detector.response": {"kind": "scintillator", "thickness_mm": 0.6},
    }
)
loads = [0.0005, 0.002, 0.008, 0.032]  # mAs of a view
scans = [simulate(noisy.with_({"source.current_ma": 100 * load})) for load in loads]
volumes = [reconstruct(scan, iterations=4) for scan in scans]

figure, axes = plt.subplots(1, 4, figsize=(11, 3.2), layout="constrained")
for axis, load, shown in zip(axes, loads, volumes, strict=True):
    axis.imshow(shown[12], cmap="gray", vmin=0.01, vmax=0.035, origin="lower")
    axis.set_title(f"{1000 * load:g} µAs a view")
    axis.axis("off")

# %%
# The difference from the volume of a scan without noise is noise alone. It falls with the square
# root of the tube load: half the noise costs four times the dose.

quiet = reconstruct(simulate(noisy.with_({"detector.noise": None})), iterations=4)
y = volume.grid.axes()[1]
water = np.hypot(x[None, :] - 18, y[:, None] - 22) < 7
mean = float(quiet[8:16, water].mean())
for load, shown in zip(loads, volumes, strict=True):
    noise = float(np.std((shown - quiet)[8:16, water])) / mean
    print(f"{1000 * load:4.1f} µAs: noise {noise:.1%} of water")

# %%
# Further effects are single keys as well: focal spot, motion during the exposure, scatter, lag,
# dead pixels, read-out. The page on X-ray physics has a picture of each.
