"""
The paper's experiment
======================

Two robot arms carry an X-ray source and a flat panel along a sine on a sphere around a skull. A
volume is reconstructed from the poses that the robots report. You will see the room, the
projections and the volume, and learn how much of its error comes from the robots.

The scenario is the demo: the experiment of Freiling et al. with fewer views, coarser pixels and
coarser voxels. Here it has 40 views, so that it runs in seconds.
"""

# %%
# Load a scenario
# ---------------
#
# A scenario is one YAML file. A second argument overrides some of its keys, as ``--set`` does
# on the command line.

import matplotlib.pyplot as plt

from twinct import evaluate, load_scenario, reconstruct, simulate
from twinct.scan import SimulationBuilder

scenario = load_scenario("demo", {"trajectory.views": 40})
print(scenario.name, "-", scenario.description)
print(scenario.detector.columns, "x", scenario.detector.rows, "pixels")

# %%
# The room
# --------
#
# A builder makes the parts of both simulations when they are needed. Here it plans the motion of
# both arms, and draws the room at view 20.

builder = SimulationBuilder(scenario)
builder.draw("room.png", view=20, width=1000, height=560)

# %%
# The scan
# --------
#
# ``simulate`` moves the arms along the plan, and renders each view at the pose where the arms
# really are. It runs in this process and writes no files; ``twinct run`` writes a folder.

scan = simulate(scenario)
scan.show("scan.png")

# %%
# Images are transmissions, 1 where nothing absorbs. ``show`` draws line integrals: minus the
# logarithm of the transmissions.

print(scan.transmission.shape, scan.transmission.min())

# %%
# The volume
# ----------
#
# ``reconstruct`` does what the scenario says: ten passes of SART, from the believed geometry.

volume = reconstruct(scan)
volume.show("volume.png")
print(f"{evaluate(scan, volume).rmse_near_rel:.1%} error near bone")

# %%
# The algorithm ``fast`` takes less time, and its error is smaller.

fast = reconstruct(scan, algorithm="fast")
print(f"{evaluate(scan, fast).rmse_near_rel:.1%} error near bone")

# %%
# What the robots cost
# --------------------
#
# A scan holds three geometries. *Commanded* is what you ask for, *executed* is where source and
# panel really were, and *believed* is what the system reports. Only a simulation knows the executed
# geometry, and can reconstruct from it.

ideal = reconstruct(scan, algorithm="fast", geometry="executed")
print(f"{evaluate(scan, ideal).rmse_near_rel:.1%} error near bone from the executed geometry")

middle = volume.shape[0] // 2
figure, axes = plt.subplots(1, 3, figsize=(10, 3.6), layout="constrained")
for axis, (name, shown) in zip(
    axes,
    {"SART, believed": volume, "fast, believed": fast, "fast, executed": ideal}.items(),
    strict=True,
):
    axis.imshow(shown[middle], cmap="gray", vmin=0, vmax=0.06, origin="lower")
    axis.set_title(name)
    axis.axis("off")

# %%
# In the paper's scenario the believed poses are off by 0.07 mm along each axis, which costs little
# in voxels of 1.24 mm. The next lessons change the object, the path, the room and the errors.
#
# On the command line
# -------------------
#
# These commands make both volumes from the believed poses, write a report, and compare the two::
#
#     twinct run demo --out out/demo --set trajectory.views=40
#     twinct reconstruct out/demo --set reconstruction.algorithm=fast
#     twinct compare out/demo out/demo/reconstructions/fast
