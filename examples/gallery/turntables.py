"""
A full circle by two arms
=========================

In ``turntables``, each arm stands on a turntable, one on the floor and one under the
ceiling. They take 180 views on a full circle, which arms on fixed bases cannot.
"""

from twinct import load_scenario
from twinct.scan import SimulationBuilder

scenario = load_scenario("turntables", {"trajectory.views": 30})
SimulationBuilder(scenario).draw("turntables.png", view=15, width=1000, height=560)

# %%
# ``cell.source_arm.turntable`` puts any arm on a turntable, ``rail`` on a linear rail:
# ``spine_rails`` scans 400 mm of a spine.
