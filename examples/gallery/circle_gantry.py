"""
A circle without arms
=====================

``scenarios/circle_gantry.yaml``: source and panel are exactly where the trajectory says.
"""

from twinct import load_scenario, simulate

scan = simulate(load_scenario("scenarios/circle_gantry.yaml", {"trajectory.views": 8}))
scan.show("circle.png")
