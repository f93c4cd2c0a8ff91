"""
Your own arms and room
======================

The paths that an arm reaches depend on its length, its base position and the obstacles in the room.
You will exchange the arms, see where they can go, and put a person into the room.
"""

# %%
# Other arms
# ----------
#
# An arm has a ``model`` and a base position. ``ur10e`` and ``lbr_iiwa14`` are built in,
# ``menagerie:NAME`` takes one of MuJoCo Menagerie, and ``file`` any MJCF or URDF. These are two
# KUKA LBR iiwa on an arc of 160 degrees, the longest that they reach at this distance.

import matplotlib.pyplot as plt

from twinct import load_scenario
from twinct.core.errors import TwinctError
from twinct.scan import SimulationBuilder

kuka = load_scenario("lbr_arc", {"trajectory.views": 25})
builder = SimulationBuilder(kuka)
builder.draw("kuka.png", view=4, width=1000, height=560)
print("joints:", *builder.cell.joint_names[:3], "...")

# %%
# The larger UR10e also reaches the paper's sine of 210 degrees. The smaller arm does not:

small = {"cell.source_arm.model": "lbr_iiwa14", "cell.detector_arm.model": "lbr_iiwa14"}
demo = {"trajectory.views": 30}
try:
    _ = SimulationBuilder(load_scenario("demo", demo | small)).plan
except TwinctError as error:
    for line in error.lines[:4]:
        print(line)

# %%
# Where the arms can go
# ---------------------
#
# ``twinct reach`` tests, for directions all over the sphere, whether the source can be there with
# the panel opposite. ``run_command`` is the command line, called from Python.

from twinct.cli import run_command

run_command("reach demo --directions 150 --out reach".split())

# %%
# The folder holds these pictures, and a table of all directions:

for name in ("sphere_300.png", "room_300.png"):
    figure, axis = plt.subplots(figsize=(10, 6), layout="constrained")
    axis.imshow(plt.imread(f"reach/{name}"))
    axis.axis("off")

# %%
# A person in the room
# --------------------
#
# The arms keep out of zones, which do not appear in images. Here a nurse stands beside the
# patient; the path is planned around her, with ``motion.clearance_mm`` to spare.

nurse = {
    "name": "nurse",
    "shape": {"kind": "capsule", "radius_mm": 200, "length_mm": 1300},
    "position_mm": [0, 900, -350],
}
with_nurse = SimulationBuilder(load_scenario("demo", demo | {"cell.zones": [nurse]}))
with_nurse.draw("nurse.png", view=5, width=1000, height=560)

# %%
# If the nurse stands closer to the isocentre, the arms find no path:

nurse["position_mm"] = [200, 450, -350]
try:
    _ = SimulationBuilder(load_scenario("demo", demo | {"cell.zones": [nurse]})).plan
except TwinctError as error:
    for line in error.lines[:3]:
        print(line)

# %%
# ``twinct place`` then searches for better positions of the bases. See the how-to page *Where
# should the arms stand?*
