"""
Calibration
===========

Real arms are not exactly where their encoders say. You will give a machine realistic errors, see
what they do to the volume, and estimate the true poses with a phantom of steel balls.
"""

# sphinx_gallery_thumbnail_number = 2

# %%
# A machine with errors
# ---------------------
#
# ``uncertainty.preset`` sets typical errors of a kind of machine. ``c_arm_uncalibrated`` bends
# under its own weight: source and panel are off by millimetres, in every scan alike. Here a gantry
# carries source and panel, because it needs no planning of motions and is quick.

import matplotlib.pyplot as plt
import numpy as np

from twinct import evaluate, load_scan, load_scenario, reconstruct, run
from twinct.cli import run_command

machine = {
    "cell": {"kind": "gantry"},
    "trajectory": {"kind": "circle", "views": 36},
    "uncertainty": {"preset": "c_arm_uncalibrated"},
    "detector": {"columns": 320, "rows": 240, "pixel_pitch_mm": 1.0},
}
grid = {"reconstruction.grid": {"voxels": 96, "voxel_mm": 1.65}, "reconstruction.iterations": 2}
skull = run(load_scenario("demo", machine | grid), "skull", link="local")
scan = load_scan("skull")
believed, executed = (scan.geometry(name) for name in ("believed", "executed"))
off = np.linalg.norm(executed.source - believed.source, axis=1)
print(f"source: {off.mean():.2f} mm from where it is believed, {off.max():.2f} mm at most")

# %%
# The phantom
# -----------
#
# The same machine scans 64 steel balls of 3 mm on a helix, along the same path. The positions of
# the balls on the helix are known.

phantom = machine | {
    "reconstruction.grid": {"voxels": 32, "voxel_mm": 5},
    "detector.pixel_samples": 4,
}
run(load_scenario("balls", phantom), "balls", link="local")
load_scan("balls").show("balls.png", views=[0, 9, 18, 27])

# %%
# From the shadows, ``calibrate beads`` estimates nine numbers for each view, three of the source
# and six of the panel, and adds the geometry ``beads`` to both scans.

run_command("calibrate beads balls --to skull".split())

# %%
# From wrong poses, from right ones
# ---------------------------------

scan = load_scan("skull")
volumes = {
    name: reconstruct(scan, algorithm="fast", geometry=name)
    for name in ("believed", "beads", "executed")
}
figure, axes = plt.subplots(1, 3, figsize=(10, 3.6), layout="constrained")
for axis, (name, volume) in zip(axes, volumes.items(), strict=True):
    axis.imshow(volume[volume.shape[0] // 2], cmap="gray", vmin=0, vmax=0.06, origin="lower")
    axis.set_title(f"{name}: {evaluate(scan, volume).rmse_near_rel:.1%} near bone")
    axis.axis("off")

# %%
# The calibrated volume is as good as that of the true poses, which no machine knows. The source is
# still off by this distance:

found = scan.geometry("beads")
print(f"source: {np.linalg.norm(executed.source - found.source, axis=1).mean():.3f} mm")

# %%
# Without a phantom, ``twinct calibrate self`` estimates the poses from the scan alone, ``calibrate
# balls`` from a few balls on the object, and ``calibrate kinematics`` corrects both arms for any
# later path.
