"""Planes of the world through several volumes, each in its own sampling."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from twinct.geometry import Floats, Pose, VolumeGrid
from twinct.report.data import PLANES, CrossSection

TURNED = 1e-9
"""Largest difference of two rotation matrices that counts as the same axes."""


class AxisPlane(NamedTuple):
    """Plane that is orthogonal to an axis of some frame.

    Attributes:
        normal: array axis (z, y, x) orthogonal to the plane.
        place_mm: position of the plane on that axis, mm.
        world_from_frame: frame of the world, or of a rotated grid.
        frame: prefix of its axes' names, empty for the world.
    """

    normal: int
    place_mm: float
    world_from_frame: Pose
    frame: str = ""


def planes_through(
    grid: VolumeGrid, bounds: Floats, world_from_specimen: Pose, hit: Callable[[VolumeGrid], bool]
) -> dict[str, AxisPlane]:
    """Return the planes in the report of a grid: through its middle, or through the specimen's.

    Args:
        grid: grid of the reference volume.
        bounds: lowest and highest corner of the specimen in its frame, (2, 3), mm.
        world_from_specimen: pose of the specimen.
        hit: function that returns whether the voxels of a grid contain any of the specimen.
    """
    turned = not np.allclose(grid.world_from_grid.rotation, np.eye(3), atol=TURNED)
    frame = grid.world_from_grid if turned else Pose.identity()
    centre = (frame.inverse() @ grid.world_from_grid).position
    half = grid.size_mm / 2 - grid.voxel / 2
    corners = np.stack(np.meshgrid(*bounds.T), axis=-1).reshape(-1, 3)
    corners = (frame.inverse() @ world_from_specimen).apply(corners)
    low, high = (
        np.clip(f(axis=0), centre - half, centre + half) for f in (corners.min, corners.max)
    )
    planes: dict[str, AxisPlane] = {}
    for name, normal in PLANES.items():
        axis = 2 - normal
        # The middle voxel, or the upper one of two.
        middle = centre[axis] + (grid.voxel[axis] / 2 if grid.shape[normal] % 2 == 0 else 0.0)
        plane = AxisPlane(normal, float(middle), frame, "grid " if turned else "")
        layer = layer_of(plane, grid)
        if layer is None or not hit(layer):
            plane = plane._replace(place_mm=float((low[axis] + high[axis]) / 2))
        planes[name] = plane
    return planes


def layer_of(plane: AxisPlane, grid: VolumeGrid) -> VolumeGrid | None:
    """Return the voxels of a grid that a plane cuts, as one layer along the plane's frame.

    The layer of a rotated grid has voxels of the grid's smallest edge, all over its bounds. None if
    the plane misses the grid.
    """
    own = plane.world_from_frame.inverse() @ grid.world_from_grid
    axis, turn = 2 - plane.normal, own.rotation
    centre, shape, edges = own.position.copy(), np.array(grid.shape_xyz), grid.voxel
    if turned := not np.allclose(turn, np.eye(3), atol=TURNED):
        edges = np.full(3, grid.voxel.min())
        shape = np.ceil(np.abs(turn) @ grid.size_mm / edges - 1e-6).astype(int)
    offset = plane.place_mm - centre[axis]
    if abs(offset) > shape[axis] * edges[axis] / 2:
        return None
    if not turned:
        first = -(shape[axis] - 1) / 2
        index = np.clip(round(offset / edges[axis] - first), 0, shape[axis] - 1)
        offset = (first + index) * edges[axis]
    centre[axis] += offset
    shape[axis] = 1
    flat = Pose.from_matrix(centre, np.eye(3))
    return VolumeGrid(shape[::-1].tolist(), edges, plane.world_from_frame @ flat)


def section_at(
    plane: AxisPlane,
    volume: ArrayLike,
    grid: VolumeGrid,
    layer: VolumeGrid,
    truth: ArrayLike | None,
    roi: ArrayLike,
) -> CrossSection:
    """Return the section of a volume in a plane: its own voxels, or the nearest in a rotated grid.

    Args:
        plane: plane of the section.
        volume: attenuation, (z, y, x), 1/mm.
        grid: the lattice of the volume.
        layer: result of ``layer_of`` for this plane and grid.
        truth: true attenuation on the layer, 1/mm; None if it is not known.
        roi: region that every view sees, on the layer, bool.

    Returns:
        The section, NaN outside the grid.
    """
    step = (np.linalg.inv(grid.affine) @ layer.affine)[:3]
    cut = scipy.ndimage.affine_transform(
        np.asarray(volume, dtype=np.float32),
        step[::-1, 2::-1],
        step[::-1, 3],
        layer.shape,
        order=0,
        mode="grid-constant",
        cval=np.nan,
    )
    own = plane.world_from_frame.inverse() @ layer.world_from_grid
    low, high = own.position - layer.size_mm / 2, own.position + layer.size_mm / 2
    up, right = (2 - axis for axis in range(3) if axis != plane.normal)
    names = [f"{plane.frame}{name}" for name in "xyz"]
    values, seen = (np.squeeze(np.asarray(a), axis=plane.normal) for a in (cut, roi))
    true = None if truth is None else np.squeeze(np.asarray(truth), axis=plane.normal)
    place = own.position[2 - plane.normal]
    return CrossSection(
        values,
        true,
        seen & np.isfinite(values),
        (low[right], high[right], low[up], high[up]),
        (names[right], names[up]),
        f"{names[2 - plane.normal]} = {place:.1f} mm",
    )
