"""Sixty trajectories that ways are sought for: a seeded list, older than what was tuned since.

All are about an isocentre with the paper's distances, 300 and 600 mm, and an upright panel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from twinct.geometry import Floats, Panel
from twinct.geometry.wire import PosePairs, targets_of
from twinct.trajectory import (
    ArcTrajectory,
    SinusoidTrajectory,
    TrajectorySettings,
    commanded_views,
    on_sphere,
)
from twinct.trajectory.orbit import orbit_views

SEED = 60


@dataclass(frozen=True)
class Named:
    """One of them.

    Attributes:
        name: what it is.
        targets: commanded poses.
        roll_free: whether source and panel may be turned about the beam.
    """

    name: str
    targets: list[PosePairs]
    roll_free: tuple[bool, bool]


def sixty(panel: Panel) -> list[Named]:
    """The list: 9 arcs, 12 spirals, 12 uniform sets, 12 shuffled ones, 15 sinusoids."""
    rng = np.random.default_rng(SEED)
    paths = _arcs(panel) + [
        (f"{what} of {views} views, {k}", _about(panel, *points(rng, views)))
        for what, points in (("spiral", _spiral), ("uniform set", _uniform))
        for views in (20, 60, 200)
        for k in range(4)
    ]
    for k in range(12):
        views = (12, 20, 40, 60)[k % 4]
        if k < 4:
            path = _commanded(
                ArcTrajectory(kind="arc", views=views, latitude_deg=rng.uniform(-30, 30)), panel
            )
        elif k < 8:
            path = _about(panel, *_spiral(rng, views))
        else:
            path = _commanded(_sinusoid(rng, views), panel)
        kind = ("arc", "spiral", "sinusoid")[k // 4]
        path = [path[index] for index in rng.permutation(views)]
        paths.append((f"shuffled {kind} of {views} views", path))
    for views in (3, 4, 6, 9, 13, 19, 27, 39, 56, 80, 115, 165, 200, 280, 399):
        paths.append((f"sinusoid of {views} views", _commanded(_sinusoid(rng, views), panel)))
    return [
        Named(f"{name}, roll {'free' if free else 'fixed'}", path, (free, free))
        for (name, path), free in zip(paths, rng.permutation(np.arange(60) % 2 == 0), strict=True)
    ]


def _arcs(panel: Panel) -> list[tuple[str, list[PosePairs]]]:
    """210 degrees at a latitude, tilted about the line from the isocentre to the middle."""
    found = []
    for latitude in (0, 20, 30):
        for tilt in (0, 20, 40):
            longitude = np.radians(np.linspace(-105, 105, 60))
            points = on_sphere(longitude, np.full(60, np.radians(latitude)), 1.0)
            points = Rotation.from_euler("x", tilt, degrees=True).apply(points)
            found.append((f"arc at latitude {latitude}, tilt {tilt}", _from(panel, points)))
    return found


def _spiral(rng: np.random.Generator, views: int) -> tuple[Floats, Floats]:
    """To and fro in longitude while the latitude rises, deg."""
    share = np.linspace(0, 1, views)
    half, ends = rng.uniform(50, 105), np.sort(rng.uniform(-30, 30, 2))
    sweeps = rng.integers(1, 5)
    return half * np.sin(2 * np.pi * sweeps * share), ends[0] + np.ptp(ends) * share


def _uniform(rng: np.random.Generator, views: int) -> tuple[Floats, Floats]:
    """Points of equal density over a band of the sphere, in no order, deg."""
    top = rng.uniform(20, 36)
    sine = rng.uniform(-1, 1, views) * np.sin(np.radians(top))
    return rng.uniform(-105, 105, views), np.degrees(np.arcsin(sine))


def _sinusoid(rng: np.random.Generator, views: int) -> SinusoidTrajectory:
    return SinusoidTrajectory(
        kind="sinusoid",
        views=views,
        longitude_range_deg=rng.uniform(120, 215),
        latitude_amplitude_deg=rng.uniform(5, 32),
        periods=rng.uniform(0.5, 4),
    )


def _commanded(section: TrajectorySettings, panel: Panel) -> list[PosePairs]:
    return targets_of(commanded_views(section, panel))


def _about(panel: Panel, longitude_deg: Floats, latitude_deg: Floats) -> list[PosePairs]:
    return _from(panel, on_sphere(np.radians(longitude_deg), np.radians(latitude_deg), 1.0))


def _from(panel: Panel, directions: Floats) -> list[PosePairs]:
    section = ArcTrajectory(kind="arc", views=len(directions))
    return targets_of(orbit_views(section, panel, section.sod_mm * directions))
