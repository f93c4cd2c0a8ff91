"""Text with the numbers of a clicked object."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from twinct.geometry import Floats, ScanGeometry
from twinct.viewer.markdown import plain
from twinct.viewer.show import Show
from twinct.viewer.slices import AXES, Plane, index_at


def of_view(show: Show, view: int) -> str:
    """Return a view's source and panel in each geometry, and the distances from those taken."""
    taken = show.taken if view < show.acquired else None
    blocks = [f"**View {view}** of {len(show)}"]
    for name, geometry in show.geometries.items():
        if view >= len(geometry):
            continue
        source, panel = geometry.source[view], geometry.detector[view]
        lines = [
            f"*{plain(name)}*",
            f"source {_point(source)} mm",
            f"panel {_point(panel)} mm",
            f"SDD {geometry[view].sdd[0]:.2f} mm",
        ]
        if taken is not None and name != show.kept:
            its = (source, taken.source[view]), (panel, taken.detector[view])
            off = [float(np.linalg.norm(mine - other)) for mine, other in its]
            lines.append(
                f"distance from {show.kept}: {off[0]:.3f} mm source, {off[1]:.3f} mm panel"
            )
        blocks.append("  \n".join(lines))
    if taken is not None:
        gap = float(show.clearance_mm[view]) if view < len(show.clearance_mm) else math.nan
        if math.isfinite(gap):
            blocks.append(f"smallest gap on the way there: {gap:.1f} mm")
    elif view in show.refused:
        blocks.append("the arms cannot reach this view")
    else:
        blocks.append("not taken yet")
    return "\n\n".join(blocks)


def of_joints(show: Show, view: int, body: str) -> str:
    """Return a body's name, and the joints of its arm."""
    lines = [f"**{plain(body)}**"]
    joints = show.joints_at(view)
    if joints is not None and show.plan is not None:
        arm = body.partition("_")[0]
        degrees = np.degrees(joints)
        rows = [
            f"| {plain(name)} | {value:.2f} |"
            for name, value in zip(show.plan.joint_names, degrees, strict=True)
            if name.startswith(f"{arm}_")
        ]
        if rows:
            lines.append("\n".join(["| joint | deg |", "|---|---|", *rows]))
    return "\n\n".join(lines)


def of_pixel(
    show: Show, drawn: ScanGeometry, view: int, origin: Floats, direction: Floats, front_mm: float
) -> str | None:
    """Return the pixel that a ray meets, and its value; None outside the panel.

    Args:
        show: the run.
        drawn: the view's geometry as drawn.
        view: index of the view.
        origin: the ray's origin, mm.
        direction: the ray's direction.
        front_mm: distance of the drawn image from the pixel plane.
    """
    n = drawn.normal[0]
    point = _met(origin, direction, drawn.detector[0] + front_mm * n, n)
    if point is None:
        return None
    panel, away = drawn.panel, point - drawn.detector[0]
    column = away @ drawn.u[0] / panel.pitch_u + panel.middle[0]
    row = away @ drawn.v[0] / panel.pitch_v + panel.middle[1]
    c, r = round(column), round(row)
    if not (0 <= c < panel.columns and 0 <= r < panel.rows):
        return None
    lines = [f"**View {view}, pixel** column {c}, row {r}"]
    if show.transmission is not None and view < show.acquired:
        value = float(show.transmission(view)[r, c])
        integral = -math.log(value) if value > 0 else math.inf
        lines.append(f"transmission {value:.5f}, line integral {integral:.4f}")
    else:
        lines.append("not taken yet")
    return "\n\n".join(lines)


def of_voxel(show: Show, axis: int, index: int, origin: Floats, direction: Floats) -> str | None:
    """Return the voxel of a slice that a ray meets, in all volumes."""
    first = next(iter(show.volumes.values()), None)
    if first is None:
        return None
    plane = Plane.of(first.grid, axis, index)
    pose = plane.world_from_plane
    point = _met(origin, direction, pose.position, pose.rotation[:, 2])
    return None if point is None else of_point(show, point, f"slice across {AXES[axis]}")


def of_point(show: Show, point: Floats, where: str) -> str | None:
    """Return all volumes' values at a point, mm."""
    lines: list[str] = []
    for name, volume in show.volumes.items():
        index = index_at(volume.grid, point)
        if index is not None:
            value = float(volume.array[index])
            lines.append(f"{plain(name)}: {value:.5f} /mm in voxel (z, y, x) {index}")
    return "\n\n".join([f"**{where}** at {_point(point)} mm", *lines]) if lines else None


def on_surface(
    show: Show, name: str, level: float, origin: Floats, direction: Floats
) -> Floats | None:
    """Return the first point of a ray at which a volume exceeds a level, mm, if any."""
    volume = show.volumes.get(name)
    if volume is None:
        return None
    direction = direction / np.linalg.norm(direction)
    half = float(np.linalg.norm(volume.grid.size_mm)) / 2
    middle = float((volume.grid.world_from_grid.position - origin) @ direction)
    steps = np.arange(max(middle - half, 0.0), middle + half, float(volume.grid.voxel.min()) / 2)
    points = origin + steps[:, None] * direction
    local = volume.grid.world_from_grid.inverse().apply(points)
    indices = np.rint((local - volume.grid.first_voxel_mm) / volume.grid.voxel).astype(int)
    inside = ((indices >= 0) & (indices < volume.grid.shape_xyz)).all(axis=1)
    i, j, k = indices[inside].T
    dense = volume.array[k, j, i] > level
    return points[inside][int(np.argmax(dense))] if dense.any() else None


def nearest_view(show: Show, name: str, origin: Floats, direction: Floats) -> int | None:
    """Return the view whose source in a geometry is nearest to a ray."""
    geometry = show.geometries.get(name)
    if geometry is None:
        return None
    away = geometry.source - origin
    direction = direction / np.linalg.norm(direction)
    return int(np.argmin(np.linalg.norm(np.cross(away, direction), axis=1)))


def _met(origin: Floats, direction: Floats, point: Floats, normal: Floats) -> Floats | None:
    """Return the intersection of a ray and a plane; None if parallel."""
    slope = float(direction @ normal)
    if abs(slope) < 1e-12:
        return None
    return origin + float((point - origin) @ normal) / slope * direction


def _point(point: Sequence[float] | Floats) -> str:
    return "(" + ", ".join(f"{x:.2f}" for x in point) + ")"
