"""
The paper's experiment, small
=============================

In ``demo``, two UR10e take 100 views on a sine of 210 degrees around a skull, and
SART reconstructs from noisy poses. It takes half a minute on two free cores; here it has 24 views.
"""

from twinct import load_scenario, reconstruct, simulate
from twinct.scan import SimulationBuilder

scenario = load_scenario("demo", {"trajectory.views": 24})
SimulationBuilder(scenario).draw("demo_room.png", view=12, width=1000, height=560)

# %%
# Projections
# -----------

scan = simulate(scenario)
scan.show("demo_scan.png")

# %%
# The volume
# ----------

volume = reconstruct(scan, algorithm="fast")
volume.show("demo_volume.png")

# %%
# Start here, and change one key at a time: ``twinct run demo --out out/mine --set
# trajectory.views=50``. ``paper`` is the experiment at full size.
