"""Trajectories: families of views for a scan, built in or from extensions."""

from twinct.trajectory.arc import ArcTrajectory
from twinct.trajectory.circle import CircleTrajectory
from twinct.trajectory.circle_arc import CircleArcTrajectory
from twinct.trajectory.families import commanded_mas, commanded_views, leaves_roll
from twinct.trajectory.family import Family, TrajectorySettings
from twinct.trajectory.helix import HelixTrajectory
from twinct.trajectory.orbit import OrbitSettings, on_sphere, orbit_views, panel_axes, stops
from twinct.trajectory.saddle import SaddleTrajectory
from twinct.trajectory.sinusoid import SinusoidTrajectory
from twinct.trajectory.spiral import SpiralTrajectory
from twinct.trajectory.sweeps import Until, ends_of_sweeps, farthest_first, in_sweeps
from twinct.trajectory.table import FileTrajectory, rows_of_views, write_rows, write_views
from twinct.trajectory.uniform import UniformTrajectory

__all__ = [
    "ArcTrajectory",
    "CircleArcTrajectory",
    "CircleTrajectory",
    "Family",
    "FileTrajectory",
    "HelixTrajectory",
    "OrbitSettings",
    "SaddleTrajectory",
    "SinusoidTrajectory",
    "SpiralTrajectory",
    "TrajectorySettings",
    "UniformTrajectory",
    "Until",
    "commanded_mas",
    "commanded_views",
    "ends_of_sweeps",
    "farthest_first",
    "in_sweeps",
    "leaves_roll",
    "on_sphere",
    "orbit_views",
    "panel_axes",
    "rows_of_views",
    "stops",
    "write_rows",
    "write_views",
]
