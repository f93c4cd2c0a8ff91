"""
Two small arms apart
====================

``lbr_apart`` places two arms of 0.82 m reach where they hold most views, as ``twinct place``
found it.
"""

from twinct import load_scenario
from twinct.scan import SimulationBuilder

scenario = load_scenario("lbr_apart")
SimulationBuilder(scenario).draw("lbr_apart.png", view=0, width=1000, height=560)
