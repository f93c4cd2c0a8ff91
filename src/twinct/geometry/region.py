"""Region that every view sees, or most, in which a reconstruction can be judged fairly."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twinct.geometry.arrays import Floats
from twinct.geometry.grid import VolumeGrid
from twinct.geometry.scan import ScanGeometry

BOUNDARY_SLACK_PX = 1e-9
"""Tolerance for voxel centres on the boundary: rounding must not break the symmetry of a scan."""

SOURCE_SLACK = 1e-9
"""Share of the source-panel distance by which a voxel must lie in front of the source."""

FEW = 2
"""Rows or columns of a panel, up to which a margin would leave no voxel, or hardly any."""

LEAST_SHARE = 0.5
"""Share of the largest number of views that sees a voxel, from which on a voxel is judged."""


def region_of_interest(
    executed: ScanGeometry, grid: VolumeGrid, margin_px: float = 0.5
) -> NDArray[np.bool_]:
    """Return the voxels whose centres are projected onto the panel in every view.

    The projection is at least ``margin_px`` from the edge of the active area. For 0.5 px, it lies
    among the pixel centres: column in [0, columns - 1] and row in [0, rows - 1].

    A scan along a long body may have no such voxel. The region then consists of the voxels that at
    least half as many views see as see the voxel that most views see: ``views_needed``.

    Returns:
        (z, y, x), True where enough views of the executed geometry see the voxel centre.
    """
    region = _seen_by_all(executed, grid, margin_px)
    if region.any():
        return region
    counts = _counts(executed, grid, margin_px)
    return counts >= max(_needed(counts), 1)


def views_needed(executed: ScanGeometry, grid: VolumeGrid, margin_px: float = 0.5) -> int:
    """Return the number of views that see each voxel of ``region_of_interest``, 0 for no region."""
    if _seen_by_all(executed, grid, margin_px).any():
        return len(executed)
    return _needed(_counts(executed, grid, margin_px))


def _needed(counts: NDArray[np.int16]) -> int:
    return int(np.ceil(LEAST_SHARE * float(counts.max(initial=0))))


def _seen_by_all(executed: ScanGeometry, grid: VolumeGrid, margin_px: float) -> NDArray[np.bool_]:
    x = grid.axes()[0]
    lower, upper = _spans(*half_spaces(executed, margin_px), grid)
    region = np.empty(grid.shape, dtype=np.bool_)
    for k in range(len(region)):
        np.greater_equal(x, lower[k, :, None], out=region[k])
        region[k] &= x <= upper[k, :, None]
    return region


def _counts(executed: ScanGeometry, grid: VolumeGrid, margin_px: float) -> NDArray[np.int16]:
    """Return the number of views that see each voxel centre, (z, y, x)."""
    normals, offsets = half_spaces(executed, margin_px)
    x, views = grid.axes()[0], len(executed)
    k, j = np.indices(grid.shape[:2])
    enters = np.zeros((*grid.shape[:2], len(x) + 1), np.int16)
    for view in range(views):
        lower, upper = _spans(normals[view::views], offsets[view::views], grid)
        first, end = np.searchsorted(x, lower, "left"), np.searchsorted(x, upper, "right")
        enters[k, j, first] += 1
        enters[k, j, np.maximum(first, end)] -= 1
    return np.cumsum(enters[..., :-1], axis=2, dtype=np.int16)


def _spans(normals: Floats, offsets: Floats, grid: VolumeGrid) -> tuple[Floats, Floats]:
    """Return where each row of voxels along x enters and leaves some half-spaces, (z, y), mm.

    Each view admits a pyramid with its tip in the source, the intersection of half-spaces
    g . (p - S) <= 0. It is convex, and each row of voxels along x enters and leaves it at most
    once. On such a row p = p0(y, z) + x e, and a half-space bounds x by
    g . (S - p0(y, z)) / (g . e), which is affine in y and z. This costs rows x half-spaces instead
    of voxels x views.
    """
    _, y, z = grid.axes()
    axes, origin = grid.world_from_grid.rotation, grid.world_from_grid.position
    slope_x, slope_y, slope_z = axes.T @ normals.T
    # Half-space: slope_x x + slope_y y + slope_z z <= room, in the coordinates of the grid.
    room = offsets - normals @ origin
    lower, upper = (np.full((len(z), len(y)), end) for end in (-np.inf, np.inf))
    for sx, sy, sz, r in zip(slope_x, slope_y, slope_z, room, strict=True):
        if sx > 0:
            np.minimum(upper, ((r - sz * z) / sx)[:, None] - sy / sx * y, out=upper)
        elif sx < 0:
            np.maximum(lower, ((r - sz * z) / sx)[:, None] - sy / sx * y, out=lower)
        else:
            lower[(r - sz * z)[:, None] - sy * y < 0] = np.inf
    return lower, upper


def half_spaces(geometry: ScanGeometry, margin_px: float) -> tuple[Floats, Floats]:
    """Return half-spaces that bound the volume seen by all views.

    With n = u x v, reach = (D - S) . n < 0 and the ray r = p - S, a point projects to

        column = (reach (r . u) / (r . n) - (D - S) . u) / pitch_u + (columns - 1) / 2,

    and it lies in front of the source where r . n < 0. Hence column >= low is
    (reach u - a n) . r <= 0 with a = (D - S) . u + (low - (columns - 1) / 2) pitch_u, and likewise
    for the other three edges. The result is unit normals g (half-spaces, 3) and offsets
    (half-spaces,), mm: g . p <= offset.
    """
    panel, n = geometry.panel, geometry.normal
    to_panel = geometry.detector - geometry.source
    reach = -geometry.sdd[:, None]
    normals: list[Floats] = []
    offsets: list[Floats] = []

    def admit(g: Floats, slack_mm: Floats | float = 0.0) -> None:
        g = g / np.linalg.norm(g, axis=1, keepdims=True)
        normals.append(g)
        offsets.append(np.einsum("vk,vk->v", g, geometry.source) + slack_mm)

    edges = ((geometry.u, panel.columns, panel.pitch_u), (geometry.v, panel.rows, panel.pitch_v))
    for axis, count, pitch in edges:
        # One or two rows have no room between their pixel centres: they see as far as they reach.
        among = count / 2 - (margin_px if count > FEW else 0)
        half_mm = (among + BOUNDARY_SLACK_PX) * pitch
        centre = np.einsum("vk,vk->v", to_panel, axis)[:, None]
        admit(reach * axis - (centre - half_mm) * n)
        admit((centre + half_mm) * n - reach * axis)
    admit(n, SOURCE_SLACK * reach[:, 0])
    return np.concatenate(normals), np.concatenate(offsets)
