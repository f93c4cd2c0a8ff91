"""Samples of the qualification tests, built from the tests' specifications.

Image coordinates: x to the right and y down, in pixels, from the upper left corner of the panel;
pixel (row, column) covers [column, column + 1) x [row, row + 1). The panel stands at a distance
along world x, its row vector is -y, its column vector -z, its centre on the x axis; the source is
at the origin.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import manifold3d
import numpy as np
import trimesh

from twinct.geometry import Floats
from twinct.specimen.surface import from_manifold, surface

TILT_RAD = np.radians(3.0)
"""Rotation of edge and wires, clockwise in the image."""

EDGE_MM, EDGE_THICKNESS_MM = 5.0, 0.01

WEDGE_PANEL_PX = 1000
WEDGE_STEPS_MM = (41.0, 35.89, 30.79, 25.68, 20.58, 15.47, 10.36, 5.26, 0.15)
"""Thickness of each step; step 1 is the lowest."""
IRON_STEPS_MM = tuple(np.linspace(10.0, 0.02, 9).round(4).tolist())
"""Steps of the iron wedge.

They are not published. The Monte Carlo references at one energy (2D-SW-1, 100 keV) match equal
steps from 10 to 0.02 mm, each to within 0.005 mm. So that case cannot fail, and says nothing about
our images.
"""
WEDGE_LEFT_PX, WEDGE_RIGHT_PX, WEDGE_JOINT_PX = 90.0, 900.0, 500.0
WEDGE_RADIUS_MM = 400.0
"""Inner radius of the shells around the focal spot."""

FACET_PX = 4.0
"""Size of the wedge's facets."""
APART_PX = 1e-5
"""Gap between steps: they are separate solids, and touching ones would share edges."""

WIRE_MM = (0.8, 0.63, 0.5, 0.4, 0.32, 0.25, 0.2, 0.16, 0.13, 0.1, 0.08, 0.063, 0.05)
"""Diameters and gaps of the duplex wires (ISO 19232-5)."""
WIRE_LENGTH_MM = 15.0
WIRE_APART_MM = 2.8
"""Distance of neighbouring pairs: room for the unsharpness of the largest detector."""
WIRE_SIDES = 96


def edge(distance_mm: float) -> trimesh.Trimesh:
    """Return a square sheet below and left of its upper right corner, which lies on the x axis.

    ``distance_mm`` is the distance of its middle from the source.
    """
    corners = EDGE_MM * np.array([[0, 0], [0, 1], [-1, 1], [-1, 0]])  # x right, y down
    turned = corners @ _clockwise(TILT_RAD).T
    near, far = (
        np.column_stack([np.full(4, distance_mm + d), -turned])
        for d in (-EDGE_THICKNESS_MM / 2, EDGE_THICKNESS_MM / 2)
    )
    return _hull(np.concatenate([near, far]))


def duplex_wires(
    panel_mm: float, middle_mm: tuple[float, float], row_length_mm: float
) -> trimesh.Trimesh:
    """Return thirteen pairs of wires just before the panel, the thickest on the left.

    Args:
        panel_mm: distance from the source to the panel; the wires almost touch it.
        middle_mm: middle of the row of pairs, x to the right and y down from the panel's centre.
        row_length_mm: length of the row; the pairs are centred in it.
    """
    place = -(3 * sum(WIRE_MM) + WIRE_APART_MM * (len(WIRE_MM) - 1)) / 2
    if -place > row_length_mm / 2:
        raise ValueError(f"the pairs need {-2 * place:.1f} mm, the row has {row_length_mm:.1f} mm")
    centre, turn = np.array(middle_mm), _clockwise(TILT_RAD)
    angles = 2 * np.pi * np.arange(WIRE_SIDES) / WIRE_SIDES
    # The area equals that of the circle.
    swell = np.sqrt(2 * np.pi / WIRE_SIDES / np.sin(2 * np.pi / WIRE_SIDES))
    wires = []
    for diameter in WIRE_MM:
        for offset in (0.5, 2.5):
            radius = swell * diameter / 2
            along = place + offset * diameter + radius * np.cos(angles)
            depth = panel_mm - WIRE_MM[0] + radius * np.sin(angles)
            ends = []
            for end in (-WIRE_LENGTH_MM / 2, WIRE_LENGTH_MM / 2):
                flat = np.column_stack([along, np.full(WIRE_SIDES, end)]) @ turn.T + centre
                # Scaled, so that its shadow equals the one of a wire on the panel.
                scale = depth / panel_mm
                ends.append(np.column_stack([depth, -flat * scale[:, None]]))
            wires.append(_hull(np.concatenate(ends)))
        place += 3 * diameter + WIRE_APART_MM
    return _together(wires)


def wedge(
    panel_mm: float,
    pitch_mm: float,
    left: Callable[[float], float] = lambda y: WEDGE_LEFT_PX,
    right: Callable[[float], float] = lambda y: WEDGE_RIGHT_PX,
    steps_mm: Sequence[float] = WEDGE_STEPS_MM,
) -> trimesh.Trimesh:
    """Return nine shells around the focal spot: each step has one thickness along all its rays.

    Args:
        panel_mm: distance from the source to the panel.
        pitch_mm: pixel pitch.
        left: x of the left end by y.
        right: x of the right end by y.
        steps_mm: thickness of each step, the lowest first.
    """
    parts, middle = [], WEDGE_PANEL_PX / 2
    for step, thickness in enumerate(steps_mm):
        top, bottom = ((len(steps_mm) - step + k) * WEDGE_PANEL_PX / 11 for k in (0, 1))
        top, bottom = top + APART_PX, bottom - APART_PX
        ys = np.linspace(top, bottom, int(np.ceil((bottom - top) / FACET_PX)) + 1)
        columns = int(np.ceil((WEDGE_RIGHT_PX - WEDGE_LEFT_PX) / FACET_PX)) + 1
        share = np.linspace(0, 1, columns)
        xs = np.array([left(y) + share * (right(y) - left(y)) for y in ys])
        down = np.repeat((middle - ys[:, None]) * pitch_mm, columns, axis=1)
        rays = np.stack([np.full_like(xs, panel_mm), (middle - xs) * pitch_mm, down], axis=-1)
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        inner, outer = WEDGE_RADIUS_MM * rays, (WEDGE_RADIUS_MM + thickness) * rays
        parts.append(_slab(inner, outer))
    return _together(parts)


def overlap_px(y: float) -> float:
    """Return the overlap of 2D-SW-3, left of the joint, in its lower three steps."""
    return max(0.0, 10 * (y - 7 * WEDGE_PANEL_PX / 11) / (3 * WEDGE_PANEL_PX / 11))


def gap_px(y: float) -> float:
    """Return the width of the gap of 2D-SW-3 in its upper three steps."""
    return max(0.0, 5 * (4 * WEDGE_PANEL_PX / 11 - y) / (3 * WEDGE_PANEL_PX / 11))


def _slab(inner: Floats, outer: Floats) -> trimesh.Trimesh:
    """Return the closed surface around two grids of points, (rows, columns, 3)."""
    rows, columns = inner.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    last = rows * columns
    quads = [
        _quads(index),
        _quads(index + last)[:, ::-1],
        _strip(index[0], last),
        _strip(index[:, -1], last),
        _strip(index[-1, ::-1], last),
        _strip(index[::-1, 0], last),
    ]
    corners = np.concatenate(quads)
    faces = np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
    mesh = surface(np.concatenate([inner.reshape(-1, 3), outer.reshape(-1, 3)]), faces)
    return surface(mesh.vertices, mesh.faces[:, ::-1]) if mesh.volume < 0 else mesh


def _quads(index: np.ndarray) -> np.ndarray:
    return np.stack(
        [index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]], axis=-1
    ).reshape(-1, 4)


def _strip(border: np.ndarray, last: int) -> np.ndarray:
    """Return quads between both grids' borders; ``border`` walks with the slab on one side."""
    return np.stack([border[1:], border[:-1], border[:-1] + last, border[1:] + last], axis=-1)


def _together(parts: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    """Join solids that do not touch into one mesh."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    return surface(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + first for part, first in zip(parts, starts, strict=True)]),
    )


def _hull(points: Floats) -> trimesh.Trimesh:
    return from_manifold(manifold3d.Manifold.hull_points(points))


def _clockwise(angle: float) -> Floats:
    """Return the rotation matrix for image points, x to the right and y down."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
