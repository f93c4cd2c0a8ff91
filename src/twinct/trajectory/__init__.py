"""Trajectories: the views a scan shall take, by families; others may add their own."""

from twinct.trajectory.arc import ArcTrajectory
from twinct.trajectory.circle import CircleTrajectory
from twinct.trajectory.families import commanded_views, leaves_roll
from twinct.trajectory.family import Family, TrajectorySettings
from twinct.trajectory.helix import HelixTrajectory
from twinct.trajectory.orbit import OrbitSettings, on_sphere, orbit_views, panel_axes, stops
from twinct.trajectory.sinusoid import SinusoidTrajectory
from twinct.trajectory.table import FileTrajectory, write_views

__all__ = [
    "ArcTrajectory",
    "CircleTrajectory",
    "Family",
    "FileTrajectory",
    "HelixTrajectory",
    "OrbitSettings",
    "SinusoidTrajectory",
    "TrajectorySettings",
    "commanded_views",
    "leaves_roll",
    "on_sphere",
    "orbit_views",
    "panel_axes",
    "stops",
    "write_views",
]
