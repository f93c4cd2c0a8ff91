"""
A head with soft tissue
=======================

``head`` adds skin, brain, eyes and nine faint inserts to the built-in skull, with
the paper's panel, path and grid.
"""

from twinct import load_scenario, simulate
from twinct.scan import SimulationBuilder

scenario = load_scenario(
    "head",
    {"trajectory.views": 12, "detector": {"columns": 320, "rows": 240, "pixel_pitch_mm": 1.0}},
)
SimulationBuilder(scenario).draw("head_room.png", view=6, width=1000, height=560)

# %%
# Projections
# -----------

scan = simulate(scenario)
scan.show("head_scan.png")

# %%
# Use this scenario to judge soft tissue; its section ``evaluation`` names the inserts. The head
# reaches out of the grid, so set ``reconstruction.surroundings``.
