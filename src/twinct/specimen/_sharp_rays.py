"""Kernels: lengths of a view's rays in the pure materials of voxels that hold volume fractions.

Between voxel centres the fractions are trilinear, and each point is of the material with the
largest one, or of nothing. A ray is sampled ``STEPS`` times a voxel along the axis that it crosses
fastest. Between two samples the fractions are linear, so that the largest of them, the upper
envelope of straight lines, gives exact places where materials meet.
"""

# numba cannot be typed: compiled functions take any numeric type.
# pyright: basic
import numpy as np
from numba import njit, prange

from twinct.specimen._grey_kernels import fractions_at
from twinct.specimen._grey_rays import OPTIONS, _ray

STEPS = 2
"""Samples for each voxel along a ray."""


@njit(**OPTIONS)
def _add_envelope(begin, end, length, sums):
    """Add the part of a length in which each of several straight lines is the highest."""
    here, at = 0, 0.0
    for k in range(1, len(begin)):
        ahead = begin[k] - begin[here]
        if ahead > 0.0 or (ahead == 0.0 and end[k] > end[here]):
            here = k
    for _ in range(len(begin)):
        soonest, following = 1.0, here
        for k in range(len(begin)):
            behind, before = begin[here] - begin[k], end[k] - end[here]
            if before > 0.0:  # line k is the higher one at the end
                crossing = behind / (behind + before)
                if crossing < soonest or (crossing == soonest and end[k] > end[following]):
                    soonest, following = crossing, k
        sums[here] += (soonest - at) * length
        if following == here:
            break
        here, at = following, soonest


@njit(parallel=True, **OPTIONS)
def add_lengths(x, shape, stride, rays, into, out):
    """Add the length of each ray of a view in each material.

    Args:
        x: volume fractions of each voxel's materials, flat, from (nz, ny, nx, materials).
        shape: (nz, ny, nx).
        stride: number of materials.
        rays: as those of ``add_amounts``.
        into: image of each material, (materials,).
        out: receives the lengths, mm, (images, rows, columns).
    """
    for row in prange(out.shape[1]):
        begin, end = np.empty(stride + 1), np.empty(stride + 1)
        sums, place = np.empty(stride + 1), np.empty(3)
        for column in range(out.shape[2]):
            axis, line, mm = _ray(rays, row, column, shape)
            low, high = line[4], line[5]
            if low >= high:
                continue
            b, c = (1 if axis == 0 else 0), (1 if axis == 2 else 2)
            middle = 0.5 * (shape[2 - axis] - 1)
            count = int(np.ceil((high - low) * STEPS))
            step = (high - low) / count
            sums[:] = 0.0
            filled = False
            for n in range(count + 1):
                at = low + n * step
                place[axis], place[b] = at + middle, line[0] + at * line[1]
                place[c] = line[2] + at * line[3]
                before, filled = filled, fractions_at(x, shape, place, end)
                if n > 0 and (before or filled):
                    _add_envelope(begin, end, step, sums)
                begin, end = end, begin
            for m in range(stride):
                out[into[m], row, column] += mm * sums[m]
