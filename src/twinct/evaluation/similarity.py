"""Structural similarity of two volumes, window by window."""

from __future__ import annotations

from functools import partial

import numpy as np
import scipy
from numpy.typing import NDArray

WINDOW = 7
"""Edge of the cubic, uniform window in voxels."""


def whole_windows(inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the centres of the windows that lie entirely in a mask."""
    if min(inside.shape) < WINDOW:
        return np.zeros(inside.shape, dtype=np.bool_)
    seen = inside.view(np.uint8)
    eroded = scipy.ndimage.minimum_filter(seen, size=WINDOW, mode="constant", cval=0)
    return eroded.view(np.bool_)


def similarities(
    truth: NDArray[np.float32],
    volume: NDArray[np.float32],
    centres: NDArray[np.bool_],
    data_range: float,
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Return the SSIM of a volume, and of a zero volume, with the truth, (windows,) each.

    Wang, Bovik, Sheikh, Simoncelli, IEEE Trans. Image Process. 13 (2004) 600, in 3-D with the
    sample covariance: with means m, (co)variances v, C1 = (0.01 L)^2 and C2 = (0.03 L)^2,

        (2 m_t m_x + C1) (2 v_tx + C2) / ((m_t^2 + m_x^2 + C1) (v_t + v_x + C2)),

    which for x = 0 is C1 C2 / ((m_t^2 + C1) (v_t + C2)).

    Args:
        truth: attenuation, (z, y, x), 1/mm.
        volume: attenuation, (z, y, x), 1/mm.
        centres: centres of the windows to include, (z, y, x); see ``whole_windows``.
        data_range: L.
    """
    mean = partial(scipy.ndimage.uniform_filter, size=WINDOW)
    sample = WINDOW**3 / (WINDOW**3 - 1)
    ux, uy = mean(truth)[centres], mean(volume)[centres]
    vx = sample * (mean(truth * truth)[centres] - ux * ux)
    vy = sample * (mean(volume * volume)[centres] - uy * uy)
    vxy = sample * (mean(truth * volume)[centres] - ux * uy)
    c1, c2 = (0.01 * data_range) ** 2, (0.03 * data_range) ** 2
    of_volume = ((2 * ux * uy + c1) * (2 * vxy + c2)) / ((ux**2 + uy**2 + c1) * (vx + vy + c2))
    return of_volume, c1 * c2 / ((ux**2 + c1) * (vx + c2))
