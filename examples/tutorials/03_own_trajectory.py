"""
Your own trajectory
===================

A trajectory is a list of poses of source and panel. You will write one, have both arms find their
way through it, see how they refuse one that they cannot follow, and learn which families are
built in.
"""

# %%
# A path of your own
# ------------------
#
# A view needs six numbers: the focal spot and the middle of the panel, in mm, in a world whose
# origin is the isocentre and whose z axis points up. Here the source swings from side to side
# while it rises: 180 degrees in longitude, 50 in latitude.

import matplotlib.pyplot as plt
import numpy as np

from twinct import evaluate, load_scenario, reconstruct, simulate
from twinct.core.errors import TwinctError
from twinct.scan import SimulationBuilder

t = np.linspace(0, 1, 40)
longitude = np.radians(-90 + 180 * t)
latitude = np.radians(-25 + 50 * t + 8 * np.sin(6 * np.pi * t))
direction = np.stack(
    [np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)],
    1,
)
source, detector = 300 * direction, -300 * direction
np.savetxt(
    "views.csv",
    np.hstack([source, detector]),
    delimiter=",",
    header="source_x,source_y,source_z,detector_x,detector_y,detector_z",
    comments="",
)

# %%
# ``kind: file`` reads this file. The panel is perpendicular to the beam; ``detector_roll: free``
# lets the arms turn it about the beam where that helps. With ``motion.order: shortest`` the views
# may stand in any order in the file: the arms take them along a short tour.

scenario = load_scenario(
    "demo",
    {"trajectory": {"kind": "file", "path": "views.csv"}, "motion.detector_roll": "free"},
)
SimulationBuilder(scenario).draw("own_path_room.png", view=30, width=1000, height=560)

# %%
# Scan along it
# -------------

scan = simulate(scenario)
volume = reconstruct(scan, algorithm="fast")
volume.show("own_path.png")
print(f"{evaluate(scan, volume).rmse_near_rel:.1%} error near bone")

# %%
# The figure shows where the source really was, and how far that is from the commanded positions:

figure = plt.figure(figsize=(10, 4), layout="constrained")
sphere = figure.add_subplot(121, projection="3d")
sphere.plot(*source.T, label="commanded")
executed = scan.geometry("executed").source
sphere.scatter(*executed.T, s=8, color="tab:red", label="executed")
sphere.set_aspect("equal")
sphere.legend()
distance = figure.add_subplot(122)
distance.plot(np.linalg.norm(executed - scan.geometry("commanded").source, axis=1))
distance.set(xlabel="view", ylabel="source, distance from its command / mm")

# %%
# The tolerance of the trigger is 1 mm: an image is taken as soon as both tools are within 1 mm of
# their targets, while they are still moving.
#
# A path that is impossible
# -------------------------
#
# These two arms cannot follow a full circle. The error names the views before anything moves.

circle = load_scenario("demo", {"trajectory": {"kind": "circle", "views": 36}})
try:
    _ = SimulationBuilder(circle).plan
except TwinctError as error:
    for line in error.lines[:4]:
        print(line)

# %%
# ``twinct check`` prints these lines, too. It looks for the smallest change that cures them, and
# draws the first view that fails.
#
# Built-in families
# -----------------
#
# ``sinusoid``, ``arc``, ``circle``, ``circle_arc``, ``saddle``, ``spiral``, ``uniform`` and
# ``helix`` need a few numbers only. The figure shows the path of the source for four of them:

from twinct.trajectory import commanded_views

families = {
    "sinusoid": {"longitude_range_deg": 210, "latitude_amplitude_deg": 30},
    "circle_arc": {"longitude_range_deg": 200},
    "saddle": {"latitude_amplitude_deg": 25},
    "spiral": {"latitude_range_deg": [-40, 40], "turns": 3},
}
figure, axes = plt.subplots(1, 4, figsize=(11, 3.2), subplot_kw={"projection": "3d"})
for axis, (kind, keys) in zip(axes, families.items(), strict=True):
    one = load_scenario("circle_gantry", {"trajectory": {"kind": kind, "views": 120, **keys}})
    axis.plot(*commanded_views(one.trajectory, one.detector.panel).source.T)
    axis.set_title(kind)
    axis.set_aspect("equal")
    axis.set_box_aspect(None, zoom=1.7)
    axis.set_axis_off()
