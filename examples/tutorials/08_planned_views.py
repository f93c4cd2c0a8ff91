"""
Views planned for a task
========================

A head with two metal screws is scanned to see what is beside one of them. Which views are worth
taking? You will state the goals, let twinct choose views, and compare these with an ordinary path.
"""

# %%
# The task
# --------
#
# The region of interest is a ball of 15 mm radius around the screw in the petrous bone. Rays
# through metal count against a view, and the views should cover the planes through the region
# (completeness). A gantry replaces the arms here, so that every direction is within reach.

import json
from pathlib import Path

import matplotlib.pyplot as plt

from twinct.cli import run_command

Path("task.yaml").write_text("""
extends: head_screws
cell: {kind: gantry}
detector: {columns: 80, rows: 60, pixel_pitch_mm: 4.0}
reconstruction: {grid: {voxels: 64, voxel_mm: 2.5}}
task:
  position_mm: [36, -8, 0]
  radius_mm: 15
  views: 24
  candidates: 120
  completeness: {within_deg: 5}
  metal: {parts: [petrous screw], weight: 1}
""")

# %%
# The plan
# --------
#
# ``twinct plan`` takes candidates all over the sphere, and adds one view after the other, each time
# the one with the largest gain.

run_command("plan task.yaml --out plan".split())

# %%
# The folder holds ``planned.yaml``, which ``twinct run`` takes like any scenario, the chosen views
# as a table, and a picture:

figure, axis = plt.subplots(figsize=(11, 5.5), layout="constrained")
axis.imshow(plt.imread("plan/plan.png"))
axis.axis("off")

# %%
# The left panel shows the chosen views on the sphere, beside the candidates and the scenario's own
# path. ``plan.json`` holds the figures of the chosen views, of evenly spread views and of this
# path:

for name, value in json.loads(Path("plan/plan.json").read_text()).items():
    print(f"{name}: {str(value)[:90]}")

# %%
# ``--try`` also images and reconstructs the chosen views and the scenario's path, and reports the
# error of both around the screw. A plan considers only the stated goals, so try it before you use
# it.
