"""The free beam: photons per pixel without an object."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import MM_PER_M, ScanGeometry


def fall_off(view: ScanGeometry, samples: int = 1) -> NDArray[np.float32]:
    """Return the exact fall-off by distance and oblique incidence, (1 m / r)^2 cos(a), per sample.

    r is the distance from the focal spot, a the angle between ray and panel normal. Photons per
    mm^2 at 1 m, times the fall-off, are photons per mm^2 of panel.

    Returns:
        (rows * samples, columns * samples), ``samples`` along each pixel edge.
    """
    panel = view.panel
    to_source = view.source[0] - view.detector[0]
    along_u = _offsets(panel.columns, samples) * panel.pitch_u - to_source @ view.u[0]
    along_v = _offsets(panel.rows, samples) * panel.pitch_v - to_source @ view.v[0]
    distance = to_source @ view.normal[0]
    squared = along_u[None, :] ** 2 + along_v[:, None] ** 2 + distance**2
    # cos(a) / r^2 = distance / r^3
    return (MM_PER_M**2 * distance / (squared * np.sqrt(squared))).astype(np.float32)


def _offsets(count: int, samples: int) -> NDArray[np.float64]:
    """Return sample positions along one edge of the panel, in pixels from its middle."""
    return (np.arange(count * samples) + 0.5) / samples - count / 2
