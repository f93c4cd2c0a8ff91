"""Where an earlier volume lies in a scan: rigid registration by the scan's own projections."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from twinct.errors import InputError
from twinct.geometry import Floats, Pose, VolumeGrid
from twinct.recon.checks import Checks, Mask, counting_rays
from twinct.recon.engine import Singles
from twinct.recon.projector import Projector
from twinct.recon.resolution import binned
from twinct.recon.sart import sart
from twinct.recon.surroundings import coarse_grid
from twinct.volume import Volume

log = logging.getLogger(__name__)

FACTORS = (8, 4, 2, 1)
"""Voxels and pixels are larger by these, one after the other."""

FEWEST, MOST = 12, 150
"""Voxels or pixels along the shortest axis that a level has."""

SMOOTH_PX = 3.0
"""Pixels of a level over which images are smooth: what is smoother does not count."""

STEPS = 20
"""At each level, at most."""

CLOSE = 0.01
"""Voxels of a level that the grid's corners may still move by in its last step."""

DIFFERENT = 2.0
"""A prior that attenuates more or less by this factor is in another unit, or of something else."""


def registered(
    A: Projector,
    line_integrals: ArrayLike,
    prior: Volume,
    *,
    start: Pose | None = None,
    mask: ArrayLike | None = None,
) -> Pose:
    """Find where an earlier volume lies in a scan, so that its line integrals are those measured.

    Gauss-Newton from coarse to fine, on robust weights (Huber 1964) of p - A x. x is the prior at
    the grid's voxels, moved, and where it has no values a few iterations of ``sart``; derivatives
    of A x are projections of the gradient of x. Images less their means over a few pixels are
    compared: what lies around the grid or is hardened is smooth, and moved the head of
    ``bench_prior`` by a millimetre. What is new counts little by its weight.

    Args:
        A: the projector, with the believed geometry.
        line_integrals: p, (views, rows, columns), mm times the unit of the prior.
        prior: the earlier volume, on any grid.
        start: first guess of the result; the identity if not given. It has to be near: within some
            centimetres and degrees.
        mask: as in ``sart``.

    Returns:
        Where the prior's world lies in the scan's.

    Raises:
        InputError: the prior does not reach into the grid, or has other line integrals than those
            measured by a factor of 2; or as in ``sart``.
    """
    checks = Checks(A.range_shape)
    p, pixels = checks.projections(line_integrals, mask)
    checks.done()
    pose = start or Pose.identity()
    smallest = min(*A.domain_shape, *A.range_shape[1:])
    for factor in [f for f in FACTORS if FEWEST <= smallest // f <= MOST] or [1]:
        grid = coarse_grid(A.grid, 0.0, factor * A.grid.voxel)
        level = A.on(grid, A.geometry.binned(factor, factor))
        pose = _at_level(level, *binned(p, pixels, (factor, factor)), prior, pose)
    if not covered(moved(prior.grid, pose), A.grid).any():
        raise InputError("the registered prior lies beside the grid: is it of the same object?")
    middle = A.grid.world_from_grid.position
    log.info(
        "prior: moved by (%.3f, %.3f, %.3f) mm at the grid's middle, turned by %.3f deg",
        *(middle - pose.inverse().apply(middle)),
        pose.angle_deg(Pose.identity()),
    )
    return pose


def moved(grid: VolumeGrid, world_from_world: Pose) -> VolumeGrid:
    """The same lattice somewhere else."""
    return VolumeGrid(grid.shape, grid.voxel, world_from_world @ grid.world_from_grid)


def covered(by: VolumeGrid, grid: VolumeGrid) -> Mask:
    """Which voxels of a grid have their centre in another, (z, y, x)."""
    z, y, x = np.ogrid[tuple(map(slice, grid.shape))]
    inside = np.ones(grid.shape, np.bool_)
    for (i, j, k, first), n in zip(_index(by, grid)[:3], by.shape_xyz, strict=True):
        place = np.asarray(i * x + j * y + first, np.float32) + np.asarray(k * z, np.float32)
        inside &= (place > -0.5) & (place < n - 0.5)
    return inside


def resampled(volume: Singles, of: VolumeGrid, at: VolumeGrid, order: int = 1) -> Singles:
    """A volume at the voxels of any other grid, (z, y, x), by splines of an order.

    Beside the volume its outermost voxels go on.
    """
    to = _index(of, at)
    ndimage: Any = scipy.ndimage  # its types take no order that is not a literal
    return ndimage.affine_transform(
        *(volume, to[2::-1, 2::-1], to[2::-1, 3], at.shape, np.float32), order=order, mode="nearest"
    )


def _index(of: VolumeGrid, at: VolumeGrid) -> Floats:
    """(4, 4): from indices (i, j, k) in one grid to those in the other."""
    return np.linalg.inv(of.affine) @ at.affine


def _at_level(A: Projector, p: Singles, mask: Mask | None, prior: Volume, pose: Pose) -> Pose:
    counts, _ = counting_rays(A, mask)
    first = sart(A, p, iterations=3, relaxation=0.3, nonnegative=True, mask=mask).array
    blur = A.grid.voxel.mean() / prior.grid.voxel[::-1] / 2
    smooth = scipy.ndimage.gaussian_filter(prior.array, np.where(blur > 0.5, blur, 0.0))
    frame = A.grid.world_from_grid
    reach = float(np.linalg.norm(A.grid.size_mm)) / 2
    for _ in range(STEPS):
        there = moved(prior.grid, pose)
        inside = covered(there, A.grid)
        x = np.where(inside, resampled(smooth, there, A.grid), first)
        estimate = A(x)
        _refuse_other_units(estimate, p, counts)
        rest = np.subtract(p, estimate, out=estimate)
        rest[~counts] = 0
        step = _step(A, x, inside, rest, counts, reach)
        pose = frame @ Pose.exp(step) @ frame.inverse() @ pose
        if np.linalg.norm(step[:3]) + reach * np.linalg.norm(step[3:]) < CLOSE * A.grid.voxel.min():
            break
    return pose


def _refuse_other_units(estimate: Singles, measured: Singles, counts: Mask) -> None:
    mine, theirs = (a.sum(dtype=np.float64, where=counts) for a in (estimate, measured))
    ratio = float(mine / theirs)
    if not 1 / DIFFERENT < ratio < DIFFERENT:
        raise InputError(
            f"the prior's line integrals are {ratio:.3g} x those measured: attenuation in 1/mm at "
            "the scan's energy needed; is it in another unit, or of something else?"
        )


def _step(
    A: Projector, x: Singles, inside: Mask, rest: Singles, counts: Mask, reach: float
) -> Floats:
    """The twist of the grid's frame that explains most of what is left, (6,), mm and rad."""
    for image in rest:
        image[:] = _edges(image)
    sizes = rest[counts]
    noise = 1.4826 * float(np.median(np.abs(sizes, out=sizes), overwrite_input=True))
    del sizes
    slopes = _slopes(A.grid, x, inside, reach)
    normal, right = np.zeros((6, 6)), np.zeros(6)
    for view, (seen, left) in enumerate(zip(counts, rest, strict=True)):
        left = left[seen].astype(np.float64)
        trust = 1.0 / np.maximum(np.abs(left) / (1.345 * noise or 1.0), 1.0)
        images = [_edges(A[view](slope)[0] * seen)[seen] for slope in slopes]
        weighted = [image * trust for image in images]
        # Sums of products without BLAS, whose threads change the last bits.
        normal += np.array([[np.sum(a * b) for a in images] for b in weighted])
        right += np.array([np.sum(a * left) for a in weighted])
    step = np.linalg.lstsq(normal, right, rcond=1e-6)[0]
    return step / np.repeat([1.0, reach], 3)


def _edges(image: Singles) -> Singles:
    """An image less its means over some pixels: what is truncated or hardened is smooth."""
    return image - scipy.ndimage.gaussian_filter(image, SMOOTH_PX)


def _slopes(grid: VolumeGrid, x: Singles, inside: Mask, reach: float) -> list[Singles]:
    """Changes of a volume that moves by 1 mm along an axis, or turns by 1 mm at the corners."""
    gz, gy, gx = (np.where(inside, g, 0) for g in np.gradient(x, *grid.voxel[::-1]))
    ax, ay, az = (axis.astype(np.float32) / np.float32(reach) for axis in grid.axes())
    ay, az = ay[:, None], az[:, None, None]
    turns = ay * gz - az * gy, az * gx - ax * gz, ax * gy - ay * gx
    return [np.asarray(-slope, np.float32) for slope in (gx, gy, gz, *turns)]
