"""
A patient's head on a table
===========================

In ``patient_head``, a phantom with grey values lies supine on a carbon plate that
the beam sees. The arms stand beside the table and scan in the plane across it.
"""

from twinct import load_scenario, simulate
from twinct.scan import SimulationBuilder

scenario = load_scenario(
    "patient_head",
    {
        "trajectory.views": 12,
        "detector": {"columns": 160, "rows": 120, "pixel_pitch_mm": 2.0},
        "specimen.parts.0.shape.voxel_mm": 2,
    },
)
SimulationBuilder(scenario).draw("patient_head_room.png", view=6, width=1000, height=560)

# %%
# Projections
# -----------

scan = simulate(scenario)
scan.show("patient_head_scan.png")

# %%
# Replace ``phantom: head`` by the path of a CT of your own. ``patient_spine``
# scans a spine.
