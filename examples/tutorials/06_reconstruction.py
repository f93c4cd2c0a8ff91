"""
Reconstruction and its pitfalls
===============================

A volume can be wrong for many reasons that have nothing to do with the robots. You will meet the
three commonest: too few views, an object larger than the field of view, and a path that misses
directions.
"""

import matplotlib.pyplot as plt
import numpy as np

from twinct import evaluate, load_scenario, reconstruct, simulate


def sections(volumes, index=None, limits=(0, 0.06)):
    """Show one axial section of each volume."""
    figure, axes = plt.subplots(
        1, len(volumes), figsize=(3 * len(volumes), 3.3), layout="constrained"
    )
    for axis, (name, volume) in zip(axes, volumes.items(), strict=True):
        middle = volume.shape[0] // 2 if index is None else index
        axis.imshow(volume[middle], cmap="gray", vmin=limits[0], vmax=limits[1], origin="lower")
        axis.set_title(name)
        axis.axis("off")


# %%
# Too few views
# -------------
#
# This scan takes the demo's skull in 20 views on a circle. SART leaves streaks; total variation
# (``fast``, and with more passes ``fista_tv``) prefers edges to streaks.

grid = {"voxels": 96, "voxel_mm": 1.65}
few = load_scenario("circle_gantry", {"trajectory.views": 20, "reconstruction.grid": grid})
scan = simulate(few)
volumes = {
    "SART, 10 passes": reconstruct(scan, algorithm="sart", iterations=10),
    "fast": reconstruct(scan, algorithm="fast"),
    "fista_tv": reconstruct(scan, algorithm="fista_tv"),
}
sections(volumes)
for name, volume in volumes.items():
    print(f"{name:16} {evaluate(scan, volume).rmse_near_rel:.1%} error near bone")

# %%
# More passes of SART help up to a point: after ten of them the error hardly changes, because 20
# views hold no more information. With noise it would rise again. An observer is a function that
# twinct calls with each event; the event ``IterationDone`` holds the volume of a pass.

from twinct.observers import IterationDone

passes = []


def keep(event):
    """Keep the volume of each pass."""
    if isinstance(event, IterationDone):
        passes.append(event.volume)


reconstruct(scan, algorithm="sart", iterations=12, observers=[keep])
errors = [evaluate(scan, one).rmse_near_rel for one in passes]
figure, axis = plt.subplots(figsize=(6, 3), layout="constrained")
axis.plot(np.arange(1, len(errors) + 1), np.multiply(100, errors), marker="o")
axis.set(xlabel="passes of SART", ylabel="error near bone / %")

# %%
# An object larger than the field of view
# ----------------------------------------
#
# The jaw and the top of the skull reach out of the grid. These parts still add to the line
# integrals, and their effect appears at the border of the volume. ``surroundings`` reconstructs
# them coarsely and removes them.

more = simulate(few.with_({"trajectory.views": 60}))
plain = reconstruct(more, algorithm="sart", iterations=5)
cleaned = reconstruct(
    more, algorithm="sart", iterations=5, surroundings={"margin_mm": 50, "voxel_mm": 5}
)
sections({"nothing taken out": plain, "surroundings taken out": cleaned}, index=20)
for name, volume in {"nothing taken out": plain, "surroundings taken out": cleaned}.items():
    print(f"{name:24} {evaluate(more, volume).rmse_near_rel:.1%} error near bone")

# %%
# A path that misses directions
# -----------------------------
#
# On a circle, no ray runs along the faces of a flat disc that lies above or below the circle's
# plane, and no algorithm can replace these missing rays: a circle violates Tuy's condition. In a
# stack of discs the outer ones get blurred faces; an arc across the circle's plane adds missing
# rays.

discs = [
    {
        "name": f"disc {k}",
        "shape": {"kind": "cylinder", "radius_mm": 35, "height_mm": 4},
        "material": "pmma",
        "position_mm": [0, 0, 10 * k],
    }
    for k in (-4, -2, 0, 2, 4)
]
stack = few.with_({"specimen": {"parts": discs}, "trajectory.views": 60})
circle = simulate(stack)
with_arc = simulate(stack.with_({"trajectory": {"kind": "circle_arc", "views": 60}}))
figure, axes = plt.subplots(1, 2, figsize=(8, 3.6), layout="constrained")
for axis, (name, one) in zip(
    axes, {"circle": circle, "circle and arc": with_arc}.items(), strict=True
):
    volume = reconstruct(one, algorithm="fast")
    axis.imshow(volume[:, volume.shape[1] // 2], cmap="gray", vmin=0, vmax=0.025, origin="lower")
    axis.set_title(name)
    axis.axis("off")
    print(f"{name:16} {evaluate(one, volume).rmse_near_rel:.1%} error near the discs")

# %%
# That is why twin arms are worth their trouble: they go where a gantry cannot.
