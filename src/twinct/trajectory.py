"""Trajectories: the views a scan shall take, equidistant along the path of the source."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import assert_never

import numpy as np

from twinct.errors import TrajectoryError
from twinct.geometry import Floats, Panel, ScanGeometry
from twinct.scenario import (
    ArcTrajectory,
    CircleTrajectory,
    FileTrajectory,
    HelixTrajectory,
    SinusoidTrajectory,
)

Section = SinusoidTrajectory | CircleTrajectory | ArcTrajectory | HelixTrajectory | FileTrajectory

_PATH_SAMPLES = 200_001
"""Points on which arc length is summed; the paper's path of 1.2 m is then exact to 1e-7 mm."""

_STEEPEST_BEAM = 1e-9
"""Smallest horizontal share of a beam that still tells which way is horizontal."""


def commanded_views(section: Section, panel: Panel) -> ScanGeometry:
    """The geometry a trajectory commands.

    The panel stands orthogonal to the beam through the isocentre, u horizontal, v upwards.

    Raises:
        TrajectoryError: a file of views that cannot be read, or a view that is none.
    """
    match section:
        case FileTrajectory():
            return _from_file(section.path, panel)
        case SinusoidTrajectory():
            sources, centres = _sinusoid(section)
        case CircleTrajectory():
            sources, centres = _circle(section)
        case ArcTrajectory():
            sources, centres = _arc(section)
        case HelixTrajectory():
            sources, centres = _helix(section)
        case _:
            assert_never(section)
    directions = (sources - centres) / section.sod_mm
    detectors = centres - (section.sdd_mm - section.sod_mm) * directions
    u, v = panel_axes(directions)
    shift = np.asarray(section.isocentre_mm)
    return ScanGeometry(sources + shift, detectors + shift, u, v, panel)


def panel_axes(towards_source: Floats) -> tuple[Floats, Floats]:
    """Axes of a panel that faces the source: u horizontal, v = n x u, which points up.

    Args:
        towards_source: unit normals n, (views, 3).

    Raises:
        TrajectoryError: a beam is vertical, so that every u is horizontal.
    """
    u = np.cross([0.0, 0.0, 1.0], towards_source)
    length = np.linalg.norm(u, axis=1)
    if (length < _STEEPEST_BEAM).any():
        raise TrajectoryError(
            f"view {int((length < _STEEPEST_BEAM).argmax())}: the beam is vertical, so no panel "
            "axis is the horizontal one; give u and v in a file of views"
        )
    u /= length[:, None]
    v = np.cross(towards_source, u)
    return u, v / np.linalg.norm(v, axis=1)[:, None]


def _on_sphere(longitude: Floats, latitude: Floats, radius: float) -> Floats:
    return radius * np.stack(
        [
            np.cos(latitude) * np.cos(longitude),
            np.cos(latitude) * np.sin(longitude),
            np.sin(latitude),
        ],
        axis=-1,
    )


def _sinusoid(section: SinusoidTrajectory) -> tuple[Floats, Floats]:
    """Longitude over its range, latitude a sine of it (Freiling et al.); both ends included."""
    share = np.linspace(0.0, 1.0, _PATH_SAMPLES)

    def position(t: Floats) -> Floats:
        longitude = np.radians(
            section.centre_longitude_deg + section.longitude_range_deg * (t - 0.5)
        )
        latitude = np.radians(section.latitude_amplitude_deg) * np.sin(
            2 * np.pi * section.periods * t
        )
        return _on_sphere(longitude, latitude, section.sod_mm)

    steps = np.linalg.norm(np.diff(position(share), axis=0), axis=1)
    length = np.concatenate([[0.0], np.cumsum(steps)])
    stops = _stops(section.views) * length[-1]
    sources = position(np.interp(stops, length, share))
    return sources, np.zeros_like(sources)


def _circle(section: CircleTrajectory) -> tuple[Floats, Floats]:
    angles = np.radians(section.centre_longitude_deg) + 2 * np.pi * (
        np.arange(section.views) / section.views
    )
    flat = _on_sphere(angles, np.zeros_like(angles), section.sod_mm)
    tilt = np.radians(section.tilt_deg)
    about_x = np.array(
        [[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]]
    )
    return flat @ about_x.T, np.zeros_like(flat)


def _arc(section: ArcTrajectory) -> tuple[Floats, Floats]:
    longitude = np.radians(
        section.centre_longitude_deg + section.longitude_range_deg * (_stops(section.views) - 0.5)
    )
    latitude = np.full_like(longitude, np.radians(section.latitude_deg))
    sources = _on_sphere(longitude, latitude, section.sod_mm)
    return sources, np.zeros_like(sources)


def _helix(section: HelixTrajectory) -> tuple[Floats, Floats]:
    turn = section.turns * (_stops(section.views) - 0.5)
    angles = np.radians(section.centre_longitude_deg) + 2 * np.pi * turn
    centres = np.zeros((section.views, 3))
    centres[:, 2] = section.pitch_mm * turn
    return _on_sphere(angles, np.zeros_like(angles), section.sod_mm) + centres, centres


def _stops(views: int) -> Floats:
    """Shares of the path at which views are taken; a single view stands in the middle."""
    return np.linspace(0.0, 1.0, views) if views > 1 else np.array([0.5])


_COLUMNS = [f"{name}_{axis}" for name in ("source", "detector", "u", "v") for axis in "xyz"]


def write_views(path: Path, geometry: ScanGeometry) -> None:
    """Write a file of views that ``kind: file`` reads back to the same numbers."""
    rows = np.hstack([geometry.source, geometry.detector, geometry.u, geometry.v])
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(_COLUMNS)
        writer.writerows([[repr(float(x)) for x in row] for row in rows])


def _from_file(path: Path, panel: Panel) -> ScanGeometry:
    """Rows of 6 numbers (S, D) or 12 (S, D, u, v), mm; a first line of names is skipped."""
    problems: list[str] = []
    rows: list[list[float]] = []
    try:
        with path.open(newline="", encoding="utf-8") as stream:
            lines = [(n, row) for n, row in enumerate(csv.reader(stream), start=1) if row]
    except (OSError, UnicodeDecodeError) as error:
        raise TrajectoryError(f"{path}: cannot read the views: {error}") from None
    lines = [(n, row) for n, row in lines if not row[0].lstrip().startswith("#")]
    for position, (number, row) in enumerate(lines):
        try:
            rows.append([float(cell) for cell in row])
        except ValueError:
            if position > 0:
                problems.append(f"{path}:{number}: {','.join(row)!r} holds something not a number")
            continue
        if len(row) not in (6, 12):
            problems.append(
                f"{path}:{number}: a view is 6 numbers (S, D) or 12 (S, D, u, v), mm; "
                f"this line has {len(row)}"
            )
        elif not np.isfinite(rows[-1]).all():
            problems.append(f"{path}:{number}: {','.join(row)!r} holds a number that is not finite")
    if not problems and not rows:
        problems.append(f"{path}: holds no view")
    if not problems and len({len(row) for row in rows}) > 1:
        problems.append(f"{path}: some lines have 6 numbers and some 12; use one form")
    if problems:
        raise TrajectoryError(problems)
    table = np.array(rows)
    source, detector = table[:, 0:3], table[:, 3:6]
    try:
        if table.shape[1] == 12:
            return ScanGeometry(source, detector, table[:, 6:9], table[:, 9:12], panel)
        beam = source - detector
        length = np.linalg.norm(beam, axis=1)
        if (length == 0).any():
            raise ValueError(f"source and panel of view {int((length == 0).argmax())} coincide")
        u, v = panel_axes(beam / length[:, None])
        return ScanGeometry(source, detector, u, v, panel)
    except ValueError as error:
        raise TrajectoryError(f"{path}: {error}") from None
