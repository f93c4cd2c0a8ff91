"""Rays that leave a body through a cut face of its CT: tissue beyond it is missing there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import Floats, ScanGeometry, VolumeGrid

RAYS = 48
"""Largest number of rays along each edge of the panel."""


@dataclass(frozen=True, eq=False)
class CutFace:
    """Face of a CT volume that cuts the body.

    Attributes:
        axis: axis of the field's grid, 0 for x.
        high: True for the face at its upper end.
        tissue: voxels of the face that hold tissue: the field's layer without this axis, in the
            order of its array, bool.
    """

    axis: int
    high: bool
    tissue: NDArray[np.bool_]

    @property
    def name(self) -> str:
        """Name of the face, such as -z."""
        return ("+" if self.high else "-") + "xyz"[self.axis]


def cut_share(cuts: Sequence[CutFace], grid: VolumeGrid, geometry: ScanGeometry) -> Floats:
    """Return the share of each view's rays through the body's box that cross a cut face.

    Args:
        cuts: faces that cut the body.
        grid: voxels of the body, in the specimen's frame.
        geometry: views in the specimen's frame.

    Returns:
        (views,), between 0 and 1; 0 for rays that miss the part.
    """
    if not cuts:
        return np.zeros(len(geometry))
    return np.array([_share(cuts, grid, geometry[view]) for view in range(len(geometry))])


def _share(cuts: Sequence[CutFace], grid: VolumeGrid, view: ScanGeometry) -> float:
    grid_from_specimen = grid.world_from_grid.inverse()
    source = grid_from_specimen.apply(view.source)[0]
    ends = grid_from_specimen.apply(_pixels(view))
    inside = _meet_box(source, ends, grid.size_mm / 2)
    if not inside.any():
        return 0.0
    ends = ends[inside]
    crossed = np.zeros(len(ends), dtype=np.bool_)
    for face in cuts:
        crossed |= _cross(grid, face, source, ends)
    return float(crossed.mean())


def _pixels(view: ScanGeometry) -> Floats:
    """Return a coarse lattice of points on the panel, (points, 3), mm."""
    width, height = view.panel.size_mm
    across, down = (np.linspace(-0.5, 0.5, min(RAYS, n)) for n in view.panel.shape[::-1])
    u, v = (a.ravel()[:, None] for a in np.meshgrid(across * width, down * height))
    return view.detector[0] + u * view.u[0] + v * view.v[0]


def _meet_box(source: Floats, ends: Floats, half: Floats) -> NDArray[np.bool_]:
    """Return the rays, from the source to their ends, that meet a centred box."""
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = ((side * half - source) / (ends - source) for side in (-1, 1))
    enter = np.nanmax(np.minimum(a, b), axis=1)
    leave = np.nanmin(np.maximum(a, b), axis=1)
    return np.maximum(enter, 0) < np.minimum(leave, 1)


def _cross(grid: VolumeGrid, face: CutFace, source: Floats, ends: Floats) -> NDArray[np.bool_]:
    """Return the rays that cross tissue in a cut face, between source and panel."""
    axis = face.axis
    # The outermost layer is empty: tissue ends at the next one.
    height = (1 if face.high else -1) * (grid.size_mm[axis] / 2 - grid.voxel[axis])
    with np.errstate(divide="ignore", invalid="ignore"):
        at = (height - source[axis]) / (ends[:, axis] - source[axis])
    met = np.isfinite(at) & (at > 0) & (at < 1)
    points = source + np.where(met, at, 0)[:, None] * (ends - source)
    index = np.rint((points - grid.first_voxel_mm) / grid.voxel).astype(int)
    others = [a for a in (2, 1, 0) if a != axis]  # in the order of the array
    rows, columns = (index[:, a] for a in others)
    there = (rows >= 0) & (columns >= 0)
    there &= (rows < face.tissue.shape[0]) & (columns < face.tissue.shape[1])
    hit = met & there
    hit[hit] = face.tissue[rows[hit], columns[hit]]
    return hit
