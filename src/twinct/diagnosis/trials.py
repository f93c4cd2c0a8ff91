"""Causes that no derivative shows: the scan is stated in another way, and other views predicted."""

from __future__ import annotations

import math

import numpy as np

from twinct.core.errors import InputError
from twinct.diagnosis.coarse import Coarse
from twinct.diagnosis.left_out import left_out
from twinct.diagnosis.shares import Share
from twinct.geometry import Floats
from twinct.recon.projector import Projector

BEYOND = 0.25
"""Margin of the wider grid, relative to the longest edge of the grid."""


def tried(scan: Coarse) -> tuple[Share, Share]:
    """Return the shares of another order of the views, and of an object beyond the grid.

    Orders are the reversed one, which is also that of an object that turns the other way or of
    mirrored columns, and that of numbers sorted as text. The grid is widened.
    """
    views, stated = len(scan.whole), left_out(scan.A, scan.p, scan.counts).squares
    orders = np.arange(views)[::-1], np.array(sorted(range(views), key=str))
    others = (scan.A.on(scan.A.grid, scan.whole[order[scan.chosen]]) for order in orders)
    shares = [_share("order", stated, scan, A) for A in others]
    return max(shares, key=lambda one: one.share), _beyond(scan, stated)


def _beyond(scan: Coarse, stated: Floats) -> Share:
    grid = scan.A.grid
    try:
        wide = scan.A.on(grid.with_voxels(grid.voxel, BEYOND * float(grid.size_mm.max())))
    except InputError:  # it would reach a source
        return Share("truncation", 0.0, 0.0, 0.0)
    return _share("truncation", stated, scan, wide)


def _share(name: str, stated: Floats, scan: Coarse, other: Projector) -> Share:
    """Return the share of the squares of left-out views that another projector explains."""
    gains = stated - left_out(other, scan.p, scan.counts).squares
    each = gains / np.maximum(stated, 1e-30)
    error = max(float(each.std(ddof=1)) / np.sqrt(len(each)), 1e-30)
    share = float(gains.sum()) / max(float(stated.sum()), 1e-30)
    whole = max(float(np.square(scan.p[1::2], dtype=np.float64).sum()), 1e-30)
    explained = math.sqrt(max(float(gains.sum()), 0.0) / whole)
    return Share(name, share, float(each.mean()) / error, explained)
