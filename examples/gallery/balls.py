"""
A phantom for calibration
=========================

``balls`` scans 64 steel balls of 3 mm on a helix, along the paper's path. Their
shadows show where source and panel were.
"""

from twinct import load_scenario, simulate

scenario = load_scenario(
    "balls",
    {"trajectory.views": 8, "detector": {"columns": 320, "rows": 240, "pixel_pitch_mm": 1.0}},
)
scan = simulate(scenario)
scan.show("balls_scan.png")

# %%
# Run it with the machine and the path of your own scan. Then ``twinct calibrate beads out/balls
# --to out/mine`` calibrates that scan.
