"""
A head with two metal screws
============================

``head_screws`` has two titanium screws of 4 x 40 mm in bone, a tube at 120 kVp and
photon noise.
"""

from twinct import load_scenario, simulate
from twinct.scan import SimulationBuilder

scenario = load_scenario("head_screws", {"trajectory.views": 12})
SimulationBuilder(scenario).draw("head_screws_room.png", view=6, width=1000, height=560)

# %%
# Projections
# -----------

scan = simulate(scenario)
scan.show("head_screws_scan.png")

# %%
# Compare volumes with and without ``reconstruction.metal={method: nmar, metal: titanium}``, or plan
# views that avoid the metal.
