"""
A long spine, on rails
======================

In ``spine_rails`` both arms ride on rails along the table, and scan 400 mm of a spine.
"""

from twinct import load_scenario
from twinct.scan import SimulationBuilder

scenario = load_scenario("spine_rails", {"trajectory.views": 40})
SimulationBuilder(scenario).draw("spine_rails.png", view=20, width=1000, height=560)
