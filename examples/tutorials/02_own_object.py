"""
The paper's experiment
======================

Two arms carry source and panel along a sine on a sphere around a skull.
"""

# %%
# A scenario file describes the whole experiment. Keys of it can be replaced:

from twinct import load_scenario, simulate

small = {"cell": {"kind": "gantry"}, "trajectory.views": 20}
scan = simulate(load_scenario("scenarios/demo.yaml", small))
scan.show("scan.png")
