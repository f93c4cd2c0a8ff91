"""
A circle without arms
=====================

``circle_gantry`` is a full circle, with source and panel exactly where the
trajectory says. It suits studies of reconstruction, and does not need the extra ``robots``.
"""

from twinct import load_scenario, reconstruct, simulate

scenario = load_scenario("circle_gantry", {"trajectory.views": 45})
scan = simulate(scenario)
scan.show("circle_gantry_scan.png")

# %%
# The volume
# ----------

volume = reconstruct(scan)
volume.show("circle_gantry_volume.png")

# %%
# A gantry takes any trajectory: ``helix``, ``saddle``, ``uniform`` or a file of poses.
