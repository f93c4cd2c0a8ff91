"""Rigid registration of an earlier volume to a scan, by the scan's own projections."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike

from twinct.core.errors import InputError
from twinct.geometry import Floats, Pose, VolumeGrid
from twinct.recon.checks import Checks, Mask, counting_rays
from twinct.recon.engine import Singles
from twinct.recon.projector import Projector
from twinct.recon.resolution import binned
from twinct.recon.sart import sart
from twinct.recon.volume import Volume

log = logging.getLogger(__name__)

FACTORS = (8, 4, 2, 1)
"""Factors by which voxels and pixels are larger, level by level."""

FEWEST, MOST = 12, 150
"""Smallest and largest number of voxels or pixels along the shortest axis of a level."""

SMOOTH_PX = 3.0
"""Blur of the background that is subtracted from images, in pixels of a level."""

STEPS = 20
"""Largest number of steps at each level."""

CLOSE = 0.01
"""Largest movement of the grid's corners in the last step of a level, in voxels of the level."""

DIFFERENT = 2.0
"""Ratio of line integrals beyond which the prior is in another unit, or of another object."""


def registered(
    A: Projector,
    line_integrals: ArrayLike,
    prior: Volume,
    *,
    start: Pose | None = None,
    mask: ArrayLike | None = None,
) -> Pose:
    """Find the pose of an earlier volume in a scan, at which its line integrals match the scan.

    Gauss-Newton steps go from coarse to fine, with robust weights (Huber 1964) of p - A x. x is the
    moved prior at the grid's voxels, and the result of a few iterations of ``sart`` where the prior
    has no values; derivatives of A x are projections of the gradient of x. Images are compared
    less their means over a few pixels: the contributions of the grid's surroundings and of beam
    hardening are smooth, and moved the head of ``bench_prior`` by a millimetre when they were
    included. New structures count little because of their weights.

    Args:
        A: the projector, with the believed geometry.
        line_integrals: p, (views, rows, columns), mm times the unit of the prior.
        prior: the earlier volume, on any grid.
        start: initial guess of the result, within some centimetres and degrees; by default the
            identity.
        mask: as in ``sart``.

    Returns:
        Pose of the prior's world in the scan's world.

    Raises:
        InputError: the prior does not reach into the grid, its line integrals differ from the
            measured ones by a factor of 2, or as in ``sart``.
    """
    checks = Checks(A.range_shape)
    p, pixels = checks.projections(line_integrals, mask)
    checks.done()
    pose = start or Pose.identity()
    smallest = min(*A.domain_shape, *A.range_shape[1:])
    for factor in [f for f in FACTORS if FEWEST <= smallest // f <= MOST] or [1]:
        grid = A.grid.with_voxels(factor * A.grid.voxel)
        level = A.on(grid, A.geometry.binned(factor, factor))
        pose = _at_level(level, *binned(p, pixels, (factor, factor)), prior, pose)
    if not covered(moved(prior.grid, pose), A.grid).any():
        raise InputError(
            "the registered prior does not overlap the grid: does it show the same object?"
        )
    middle = A.grid.world_from_grid.position
    log.info(
        "prior: moved by (%.3f, %.3f, %.3f) mm at the grid's middle, turned by %.3f deg",
        *(middle - pose.inverse().apply(middle)),
        pose.angle_deg(Pose.identity()),
    )
    return pose


def moved(grid: VolumeGrid, world_from_world: Pose) -> VolumeGrid:
    """Return the same lattice at another pose."""
    return VolumeGrid(grid.shape, grid.voxel, world_from_world @ grid.world_from_grid)


def covered(by: VolumeGrid, grid: VolumeGrid) -> Mask:
    """Return the mask of a grid's voxels that have their centre in another grid, (z, y, x)."""
    z, y, x = np.ogrid[tuple(map(slice, grid.shape))]
    inside = np.ones(grid.shape, np.bool_)
    for (i, j, k, first), n in zip(_index(by, grid)[:3], by.shape_xyz, strict=True):
        place = np.asarray(i * x + j * y + first, np.float32) + np.asarray(k * z, np.float32)
        inside &= (place > -0.5) & (place < n - 0.5)
    return inside


def resampled(volume: Singles, of: VolumeGrid, at: VolumeGrid, order: int = 1) -> Singles:
    """Return a volume at the voxels of any other grid, (z, y, x), by splines of an order.

    Beyond the volume its outermost voxels continue.
    """
    return _transformed(volume, of, at, order=order, mode="nearest")


def means_at(volume: Singles, of: VolumeGrid, at: VolumeGrid) -> Singles:
    """Return the means of a volume over the voxels of any other grid, (z, y, x), by cubic splines.

    Voxels that are smaller than the grid's are averaged: values at the grid's centres alone would
    hold the noise and the edges of single ones.
    """
    numbers = [max(round(float(own)), 1) for own in at.voxel / of.voxel]
    if numbers == [1, 1, 1]:
        return resampled(volume, of, at, order=3)
    means = np.empty(at.shape, np.float32)
    splines = scipy.ndimage.spline_filter(volume, 3, np.float32)
    nx, ny, nz = numbers
    _, rows, columns = at.shape
    for k, plane in enumerate(means):
        shift = (k - (at.shape[0] - 1) / 2) * float(at.voxel[2])
        place = at.world_from_grid @ Pose.from_matrix(np.array([0.0, 0.0, shift]), np.eye(3))
        slab = VolumeGrid((nz, ny * rows, nx * columns), at.voxel / numbers, place)
        fine = _transformed(splines, of, slab, order=3, mode="mirror", prefilter=False)
        fine.reshape(nz, rows, ny, columns, nx).mean((0, 2, 4), out=plane)
    return means


def _transformed(volume: Singles, of: VolumeGrid, at: VolumeGrid, **keys: Any) -> Singles:
    to = _index(of, at)
    ndimage: Any = scipy.ndimage  # its types take no order that is not a literal
    return ndimage.affine_transform(
        *(volume, to[2::-1, 2::-1], to[2::-1, 3], at.shape, np.float32), **keys
    )


def _index(of: VolumeGrid, at: VolumeGrid) -> Floats:
    """Return the matrix (4, 4) from indices (i, j, k) in grid ``at`` to indices in grid ``of``."""
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
            f"the prior's line integrals are {ratio:.3g} times the measured ones: the prior must "
            "hold attenuation in 1/mm at the scan's energy; is it in another unit, or of another "
            "object?"
        )


def _step(
    A: Projector, x: Singles, inside: Mask, rest: Singles, counts: Mask, reach: float
) -> Floats:
    """Return the twist of the grid's frame that best explains the residual, (6,), mm and rad."""
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
    """Subtract local means from an image: effects of truncation and beam hardening are smooth."""
    return image - scipy.ndimage.gaussian_filter(image, SMOOTH_PX)


def _slopes(grid: VolumeGrid, x: Singles, inside: Mask, reach: float) -> list[Singles]:
    """Return a volume's changes by 1 mm of motion along each axis, and of turn at the corners."""
    gz, gy, gx = (np.where(inside, g, 0) for g in np.gradient(x, *grid.voxel[::-1]))
    ax, ay, az = (axis.astype(np.float32) / np.float32(reach) for axis in grid.axes())
    ay, az = ay[:, None], az[:, None, None]
    turns = ay * gz - az * gy, az * gx - ax * gz, ax * gy - ay * gx
    return [np.asarray(-slope, np.float32) for slope in (gx, gy, gz, *turns)]
