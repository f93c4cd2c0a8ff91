"""Paths that are drawn: points on the sphere of source directions, and a spline through them.

The views are written to a file, which the scenario names (``trajectory: {kind: file}``). The points
lie beside it, so that the path can be changed later.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from twinct.core.errors import InputError
from twinct.core.files.boundary import no_file
from twinct.core.files.plain_json import read_json
from twinct.core.files.writing import storage_errors, write_json
from twinct.design.own_folder import relative_to_file, room_in
from twinct.geometry import Floats, Panel, ScanGeometry
from twinct.trajectory import OrbitSettings, write_views
from twinct.trajectory.orbit import orbit_views

MOST_POINTS = 200
CLOSEST_DEG = 0.5
"""Smallest angle between two points in a row: a click on the same place adds none."""

DENSE = 4000
"""Points at which the length of the curve is measured."""


@dataclass(frozen=True)
class DrawnPath:
    """Points of a path on a sphere about the isocentre.

    Attributes:
        points: unit vectors from the isocentre to the source, in the order of the path.
        isocentre_mm: middle of the sphere.
        sod_mm: distance from source to isocentre.
        sdd_mm: distance from source to panel.
        views: number of views.
    """

    points: tuple[tuple[float, float, float], ...]
    isocentre_mm: tuple[float, float, float]
    sod_mm: float
    sdd_mm: float
    views: int

    def with_point(self, origin: Floats, along: Floats) -> DrawnPath:
        """Return the path with one more point, where a ray first meets the sphere.

        Args:
            origin: start of the ray, mm, (3,).
            along: its direction, (3,).

        Raises:
            InputError: the ray misses the sphere, or there are too many points.
        """
        point = sphere_point(origin, along, np.asarray(self.isocentre_mm), self.sod_mm)
        if point is None:
            raise InputError("this is beside the sphere of directions: click on one of its dots")
        if len(self.points) >= MOST_POINTS:
            raise InputError(f"a path has at most {MOST_POINTS} points")
        if self.points and _angle_deg(np.asarray(self.points[-1]), point) < CLOSEST_DEG:
            return self
        x, y, z = (round(float(number), 6) for number in point)
        return replace(self, points=(*self.points, (x, y, z)))

    def directions(self, count: int) -> Floats:
        """Return directions along the spline, at equal angles from one to the next, (count, 3).

        Raises:
            InputError: there are fewer than two points.
        """
        if len(self.points) < 2:
            raise InputError("a path needs at least two points: click on the sphere of directions")
        knots = np.asarray(self.points, dtype=float)
        knots /= np.linalg.norm(knots, axis=1, keepdims=True)
        steps = [_angle_deg(one, other) for one, other in zip(knots[:-1], knots[1:], strict=True)]
        at = np.concatenate([[0.0], np.cumsum(steps)])
        curve = CubicSpline(at, knots, bc_type="natural")
        fine = curve(np.linspace(0, at[-1], DENSE))
        fine /= np.linalg.norm(fine, axis=1, keepdims=True)
        passed = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(fine, axis=0), axis=1))])
        even = np.linspace(0, passed[-1], count)
        found = np.stack([np.interp(even, passed, fine[:, k]) for k in range(3)], axis=1)
        return found / np.linalg.norm(found, axis=1, keepdims=True)

    def geometry(self, panel: Panel) -> ScanGeometry:
        """Return the views; the panel is upright.

        Raises:
            InputError: there are fewer than two points.
            TrajectoryError: a view looks straight up or down.
        """
        section = OrbitSettings.model_validate(
            {
                "views": self.views,
                "isocentre_mm": self.isocentre_mm,
                "sod_mm": self.sod_mm,
                "sdd_mm": self.sdd_mm,
            }
        )
        return orbit_views(section, panel, self.sod_mm * self.directions(self.views))

    def keep(self, file: Path, panel: Panel) -> dict[str, Any]:
        """Write views and points to the folder of a scenario file; return the keys that name them.

        Raises:
            InputError: there are fewer than two points, or a view looks straight up or down.
            StorageError: the folder cannot be written.
        """
        views = self.geometry(panel)
        path = room_in(file, "path", ".csv")
        with storage_errors(path):
            write_views(path, views)
            write_json(_points_of(path), self._data)
        return {"trajectory": {"kind": "file", "path": relative_to_file(path, file)}}

    @property
    def _data(self) -> dict[str, Any]:
        return {
            "points": [list(point) for point in self.points],
            "isocentre_mm": list(self.isocentre_mm),
            "sod_mm": self.sod_mm,
            "sdd_mm": self.sdd_mm,
            "views": self.views,
        }


def sphere_point(origin: Floats, along: Floats, centre: Floats, radius: float) -> Floats | None:
    """Return the unit vector from the centre to where a ray first meets a sphere; None if never."""
    along = np.asarray(along) / np.linalg.norm(along)
    off = np.asarray(origin) - centre
    half, rest = float(off @ along), float(off @ off) - radius**2
    root = half**2 - rest
    if root < 0:
        return None
    ways = [way for way in (-half - root**0.5, -half + root**0.5) if way > 0]
    return None if not ways else (off + ways[0] * along) / radius


def drawn_path_of(views: Path) -> DrawnPath | None:
    """Return the points of a file of views that was drawn; None of others, or if they are gone."""
    path = _points_of(views)
    if no_file(path):
        return None
    try:
        data: Any = read_json(path)
        points = tuple((float(x), float(y), float(z)) for x, y, z in data["points"])
        x, y, z = (float(number) for number in data["isocentre_mm"])
        sod, sdd = float(data["sod_mm"]), float(data["sdd_mm"])
        return DrawnPath(points[:MOST_POINTS], (x, y, z), sod, sdd, int(data["views"]))
    except (InputError, OSError, ValueError, TypeError, KeyError):
        return None


def _points_of(views: Path) -> Path:
    return views.with_suffix(".points.json")


def _angle_deg(one: Floats, other: Floats) -> float:
    return float(np.degrees(np.arccos(np.clip(one @ other, -1.0, 1.0))))
