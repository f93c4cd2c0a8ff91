"""
Two small arms on an arc
========================

In ``lbr_arc``, two KUKA LBR iiwa 14 with seven joints each scan the longest arc that
they reach at 300 mm: 160 degrees.
"""

from twinct import load_scenario, simulate
from twinct.scan import SimulationBuilder

scenario = load_scenario("lbr_arc", {"trajectory.views": 12})
SimulationBuilder(scenario).draw("lbr_arc_room.png", view=6, width=1000, height=560)

# %%
# Projections
# -----------

scan = simulate(scenario)
scan.show("lbr_arc_scan.png")

# %%
# One key selects another arm: ``cell.source_arm.model``. ``twinct place`` finds where it should
# stand.
