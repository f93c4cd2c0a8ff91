"""
A panel of 43 x 43 cm
=====================

``scenarios/wide_panel.yaml``. The paper's path further out, with a panel that takes a whole head.
Bases and stand-offs leave the larger panel its room.
"""

from twinct import load_scenario, simulate
from twinct.scan import SimulationBuilder

scenario = load_scenario("scenarios/wide_panel.yaml", {"trajectory.views": 12})
SimulationBuilder(scenario).draw("wide_panel_room.png", view=6, width=1000, height=560)

# %%
# Projections
# -----------

scan = simulate(scenario)
scan.show("wide_panel_scan.png")

# %%
# Take it when your object reaches out of the field of view, and the arms have the room.
