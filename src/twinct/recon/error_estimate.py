"""Error of a volume, estimated without ground truth: its distance to the volume of ``fast``.

Errors of ``sart`` fall while edges form. They then rise as voxels take up noise, errors of the
poses and, above all, effects that no volume explains, such as rings at edges. All views share most
of these effects, so that neither omitted views nor the difference between two halves of a scan
reveal them. The volume of ``fast`` does. It takes up less of them, because it lowers the total
variation as strongly as the noise requires, and it forms edges in few passes. For the truth t and
the volume of ``fast`` s,

    |x - s|^2 = |x - t|^2 - 2 <x - t, s - t> + |s - t|^2.

The last term is constant, and the second one changes little: errors that further passes add to x
are mostly missing in s. So the distance falls and rises with the error.
"""

from __future__ import annotations

import logging
import math

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.geometry.region import region_of_interest
from twinct.recon.checks import Mask
from twinct.recon.engine import Singles
from twinct.recon.fast import fast
from twinct.recon.projector import Projector
from twinct.recon.steps import Callback, sum_of_squares
from twinct.recon.stopping import Estimate

log = logging.getLogger(__name__)

FAINTEST = 0.1
"""Value of voxels that count, relative to the densest ones: air is not judged."""

AROUND = 2
"""Distance from these voxels within which others count as well, in voxels: edges lie there."""


def error_estimate(
    A: Projector,
    p: Singles,
    pixels: Mask | None,
    photons: NDArray[np.float64] | None,
    callback: Callback | None = None,
) -> Estimate:
    """Return a function of a volume: the root mean square of its difference from that of ``fast``.

    It covers the specimen's voxels in the volume of ``fast``, and those close to them, as far as
    every view sees them; or all of these, if no view does. ``fast`` has its defaults.

    Args:
        A: the projector.
        p: line integrals, (views, rows, columns).
        pixels: mask, as in ``fast``.
        photons: photons of a pixel in the free beam, by view, (views,), if known.
        callback: called after each update of ``fast``.
    """
    log.info("the volume of fast will show the best pass")
    stand_in = fast(A, p, mask=pixels, photons=photons, callback=callback).array
    counts = stand_in > FAINTEST * np.percentile(stand_in[::2, ::2, ::2], 99.9)
    counts = scipy.ndimage.binary_dilation(counts, iterations=AROUND)
    seen = counts & region_of_interest(A.geometry, A.grid)
    if seen.any():
        counts = seen
    number = max(int(counts.sum()), 1)

    def estimate(x: Singles) -> float:
        planes = ((a - b) * c for a, b, c in zip(x, stand_in, counts, strict=True))
        return math.sqrt(sum(sum_of_squares(plane[None]) for plane in planes) / number)

    return estimate
