"""
A panel of 43 x 43 cm
=====================

``wide_panel`` has the paper's path further out, and a panel whose field of view
holds a whole head. Base positions and stand-offs leave room for the larger panel.
"""

from twinct import load_scenario, simulate
from twinct.scan import SimulationBuilder

scenario = load_scenario("wide_panel", {"trajectory.views": 12})
SimulationBuilder(scenario).draw("wide_panel_room.png", view=6, width=1000, height=560)

# %%
# Projections
# -----------

scan = simulate(scenario)
scan.show("wide_panel_scan.png")

# %%
# Use this scenario if your object reaches out of the field of view of the smaller panel, and the
# arms have enough room.
