"""Streaks around metal: errors that depend on the direction."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.geometry import Floats

SECTORS = 24
"""Number of sectors about an implant's long axis."""

SLICE_MM = 2.0
"""Thickness of the slices across the long axis."""


def streak_index(error: ArrayLike, sector: ArrayLike, slices: ArrayLike) -> float:
    """Return the spread of a shell's mean error between sectors, corrected for noise.

    In each slice, the variance of the sectors' means comes from streaks, and from the noise that is
    left in each mean. The noise term, the variance inside the sectors over their number of voxels,
    is subtracted, as in the analysis of variance of one random effect. The truth's own structure is
    not in the error. An artefact index that subtracts the variance of noise from the variance of a
    region with streaks is customary (Lin et al., J. Comput. Assist. Tomogr. 35 (2011) 294); the use
    of the profile over the angle, pooled over slices, is ours. An error
    a cos(2 phi) has the index a / sqrt(2). Noise that is correlated between neighbouring voxels is
    removed only in part.

    Args:
        error: volume less truth, (voxels,), such as relative to a mu.
        sector: sector of each voxel, (voxels,), whole numbers from 0.
        slices: slice of each voxel, (voxels,), whole numbers from 0.

    Returns:
        The index in the unit of the error; NaN if no slice has two sectors.
    """
    error = np.asarray(error, dtype=np.float64)
    sector, slices = np.asarray(sector, dtype=np.intp), np.asarray(slices, dtype=np.intp)
    shape = (int(slices.max(initial=0)) + 1, int(sector.max(initial=0)) + 1)
    group = slices * shape[1] + sector
    count = np.bincount(group, minlength=shape[0] * shape[1]).reshape(shape)
    held = count > 1
    total = np.bincount(group, error, count.size).reshape(shape)
    mean = np.divide(total, count, out=np.zeros(shape), where=held)
    left = (error - mean.ravel()[group])[held.ravel()[group]]
    sectors = held.sum(axis=1)
    counted = sectors > 1
    freedom = int((sectors[counted] - 1).sum())
    if not freedom:
        return math.nan
    within = float(left @ left) / max(int((count[held] - 1).sum()), 1)
    middle = mean.sum(axis=1) / np.maximum(sectors, 1)
    square = (np.where(held, mean - middle[:, None], 0.0) ** 2).sum(axis=1)[counted].sum()
    of_noise = np.divide(1.0, count, out=np.zeros(shape), where=held).sum(axis=1)
    of_noise = (of_noise * (sectors - 1) / np.maximum(sectors, 1))[counted].sum() * within
    return math.sqrt(max(float(square - of_noise), 0.0) / freedom)


def around_axis(points: Floats, body: Floats) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the sector about a body's longest axis, and the slice across it, of points.

    Args:
        points: (points, 3), mm.
        body: points that fill the body, (n, 3), mm, in the same frame.
    """
    centre = body.mean(axis=0)
    _, axes = np.linalg.eigh(np.cov((body - centre).T))
    u, v, along = ((points - centre) @ axes).T
    turn = np.arctan2(v, u) / (2 * np.pi) % 1.0
    sector = np.minimum((turn * SECTORS).astype(np.intp), SECTORS - 1)
    return sector, ((along - along.min(initial=0.0)) / SLICE_MM).astype(np.intp)
