"""Causes that the images show without a volume: a panel that cuts the object off, stuck pixels."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy

from twinct.diagnosis.coarse import Coarse

AIR_PERCENT, AIR_PIXELS = 5.0, 3
"""Share of the outermost rays, in %, taken for air, as means of squares of so many pixels."""

MUCH = 0.05
"""Mean line integral of the outermost columns, relative to that of all rays."""

STUCK = 1e-3
"""Share of the pixels at an end of the range from which they are starved or saturated."""


def facts(scan: Coarse) -> Iterator[str]:
    """Yield the names of causes that the images show."""
    if max(float(end[scan.counts].mean()) for end in (scan.lowest, scan.highest)) > STUCK:
        yield "pixels"
    if _cut_off(scan):
        yield "truncation"


def _cut_off(scan: Coarse) -> bool:
    """Return whether rays at both sides of the panel are attenuated, over all views.

    The projections may agree all the same, so no residual shows it. A shifted panel cuts off one
    side only, which it sees half a turn later.
    """
    columns = np.flatnonzero(scan.counts.any(axis=(0, 1)))[[0, -1]]
    counts = scan.counts[:, :, columns]
    smooth = scipy.ndimage.uniform_filter(scan.p, (0, AIR_PIXELS, AIR_PIXELS))[:, :, columns]
    # Flats of a brighter beam darken the air; scattered photons and noise brighten some of it.
    level = max(float(np.percentile(smooth[counts], AIR_PERCENT)), 0.0)
    usual = float(scan.p[scan.counts].mean()) - level
    sides = (scan.p[:, :, side][counts[:, :, at]] for at, side in enumerate(columns))
    return usual > 0 and all(float(side.mean()) - level > MUCH * usual for side in sides)
