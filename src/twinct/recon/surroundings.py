"""Truncation: removal of the grid's surroundings from the line integrals.

A specimen that extends beyond the grid adds to the line integrals, but no voxel can take up the
addition; the algorithms press it into the voxels at the edge, and some of it into the middle. Two
steps remove it (Ziegler, Nielsen, Grass, Med Phys 35, 2008). A coarse grid that is larger by a
margin on every side is reconstructed from binned projections with ``sart``. Its part outside the
grid is projected at full resolution and subtracted. That part is computed as the coarse volume's
line integrals less the line integrals of the same volume interpolated on the grid, so that nothing
is blurred across the border.

One grid with coarse voxels around fine ones would be worse: every projector and algorithm would
have to support both lattices, a border inside the volume causes artefacts, and the coarse voxels
would be updated in every iteration. This method costs two projections and, if the coarse voxels are
many times larger, part of an iteration; and any algorithm may follow.

From few views the coarse volume is poor, and its deficits around the grid harm the grid. With
``expected``, the line integrals of these values are left out first, so that the coarse volume has
to explain little but the surroundings.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from twinct.core.errors import InputError
from twinct.core.foreign_text import quoted
from twinct.geometry import ScanGeometry, VolumeGrid
from twinct.recon.checks import Checks, mask_of, masked_image, remainder, start_volume
from twinct.recon.engine import Singles
from twinct.recon.memory import advice, refuse_if_short
from twinct.recon.projector import Projector, check_grid
from twinct.recon.resolution import binned, interpolated
from twinct.recon.sart import sart
from twinct.recon.steps import Callback


def without_surroundings(
    A: Projector,
    line_integrals: ArrayLike,
    *,
    margin_mm: float | ArrayLike,
    voxel_mm: float,
    iterations: int = 20,
    relaxation: float = 1.0,
    nonnegative: bool = True,
    expected: ArrayLike | None = None,
    mask: ArrayLike | None = None,
    callback: Callback | None = None,
) -> Singles:
    """Subtract the surroundings of the grid from the line integrals, for any algorithm.

    Contents beyond the margin stay unexplained: the specimen should end within the margin.

    Peak memory: 1.1 volumes and 1.5 times the projections, besides the input (with coarse voxels of
    four times the edge or more); with ``expected`` the projections once more.

    Args:
        A: the projector, with the believed geometry and the grid that will be reconstructed.
        line_integrals: p, (views, rows, columns), mm times the unit of the result.
        margin_mm: margin of the coarse grid on each side; or for each axis; or
            ((x, y, z), (x, y, z)) on the lower and on the upper sides.
        voxel_mm: coarse voxel edge, adjusted so that a whole number of them spans the grid.
        iterations: iterations of the coarse ``sart``; the rest stays in the line integrals, and
            makes the grid's values too high or too low over wide areas.
        relaxation: relaxation of the coarse ``sart``.
        nonnegative: clip the coarse ``sart`` at zero.
        expected: expected values of the grid, as far as they are known, (z, y, x).
        mask: True where a pixel counts, (rows, columns) or (views, rows, columns), bool.
        callback: callback of the coarse ``sart``.

    Returns:
        (views, rows, columns), float32; 0 where the mask is False.

    Raises:
        InputError: the coarse grid reaches behind a source; or as in ``sart``.
    """
    geometry, grid = A.geometry, A.grid
    checks = Checks(A.range_shape)
    p, pixels = checks.projections(line_integrals, mask)
    margins = np.asarray(margin_mm, dtype=np.float64)
    if not (np.isfinite(margins).all() and (margins >= 0).all() and margins.any()):
        checks.problems.append(
            f"margin_mm is {quoted(margin_mm)}; it must be a finite number above 0"
        )
    if not (voxel_mm > 0 and math.isfinite(voxel_mm)):
        checks.problems.append(
            f"voxel_mm is {quoted(voxel_mm)}; it must be a finite number above 0"
        )
    expected = checks.start(expected, A.domain_shape, "expected")
    checks.done()
    coarse = grid.with_voxels(voxel_mm, margins)
    factors = _binning(geometry, coarse)
    refuse_if_short(
        surroundings_bytes(geometry, grid, margin_mm=margins, voxel_mm=voxel_mm),
        f"removing the surroundings on a grid of {coarse.shape} voxels",
        advice(),
    )
    check_margin(geometry, grid, margins, voxel_mm)
    outer = A.on(coarse)
    unknown = p
    if expected is not None:
        inner = start_volume(A, expected, nonnegative=False)
        unknown = remainder(A, inner, p, range(len(A)), pixels)
    coarser, coarser_mask = binned(unknown, pixels, factors)
    del unknown
    volume = sart(
        A.on(coarse, geometry.binned(*factors)),
        coarser,
        iterations=iterations,
        relaxation=relaxation,
        nonnegative=nonnegative,
        mask=coarser_mask,
        callback=callback,
    )
    del coarser
    inside = interpolated(volume.array, coarse, grid)
    rest = np.empty(p.shape, np.float32)
    for view, image in enumerate(rest):
        image[:] = masked_image(p, view, pixels)
        outside = outer[view](volume.array)[0] - A[view](inside)[0]
        image -= outside if pixels is None else np.where(mask_of(pixels, view), outside, 0)
    return rest


def check_margin(
    geometry: ScanGeometry, grid: VolumeGrid, margin_mm: float | ArrayLike, voxel_mm: float
) -> None:
    """Check that the coarse grid lies in front of all sources, without a projector.

    Raises:
        InputError: the coarse grid reaches behind a source.
    """
    try:
        check_grid(geometry, grid.with_voxels(voxel_mm, margin_mm))
    except InputError as error:
        widest = float(np.max(margin_mm))
        raise InputError(
            f"with margin_mm {widest:g}, {problem}" for problem in error.problems
        ) from None


def surroundings_bytes(
    geometry: ScanGeometry, grid: VolumeGrid, *, margin_mm: float | ArrayLike, voxel_mm: float
) -> int:
    """Return the bytes that ``without_surroundings`` needs besides the given line integrals."""
    coarse = grid.with_voxels(voxel_mm, margin_mm)
    across, up = _binning(geometry, coarse)
    coarser = geometry.panel.rows // across * (geometry.panel.columns // up)
    pixels = len(geometry) * (math.prod(geometry.panel.shape) + coarser)
    return 4 * (math.prod(grid.shape) + 2 * math.prod(coarse.shape) + pixels)


def _binning(geometry: ScanGeometry, coarse: VolumeGrid) -> tuple[int, int]:
    """Return the pixels to average along v and u: at the grid's middle at most a coarse voxel."""
    panel = geometry.panel
    to_middle = geometry.depth(coarse.world_from_grid.position)
    shadow = float((coarse.voxel.min() * geometry.sdd / np.maximum(to_middle, 1e-9)).min())
    return (
        int(np.clip(shadow / panel.pitch_v, 1, panel.rows)),
        int(np.clip(shadow / panel.pitch_u, 1, panel.columns)),
    )
