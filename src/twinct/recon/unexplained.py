"""Line integrals that a volume leaves unexplained: a sign that the model of the rays is wrong.

A volume that was fitted to its projections leaves their noise, and edges that voxels cannot show.
More is left where the projections contradict each other: the poses are wrong, the object moved,
metal starved or hardened the rays, or something beside the grid attenuates some of them. Noise is
known from the number of photons, or from air in the projections; it is taken out. What edges leave
is in proportion to the attenuation of a voxel over that of a path (``PER_VOXEL``).

The opposite does not hold: scatter and beam hardening can look like another object, which explains
the projections well.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinct.recon.air import DARKEST, noise_in_air
from twinct.recon.checks import Mask, counting_rays, masked_image
from twinct.recon.engine import Singles
from twinct.recon.projector import Projector

MOST_VIEWS = 16
"""Number of views, spread over the scan, that are compared."""

PER_VOXEL = 0.28
"""Share that edges leave, times the number of voxels on a path.

From one foam of the zoo (benchmarks/zoo.py). Of 80 other scans, 50 leave 0.6 to 1.8 times as much,
and 15 less; the others hold metal or thin parts, or have 300 photons a pixel.
"""


@dataclass(frozen=True)
class Unexplained:
    """Rest of the line integrals of rays through the grid that a volume leaves, beyond their noise.

    Attributes:
        share: root mean square of p - A x beyond the noise, relative to that of p.
        noise: root mean square of the noise, relative to that of p.
        edges: share that edges in voxels of this size usually leave.
    """

    share: float
    noise: float
    edges: float


def compared_views(views: int) -> range:
    """Return the numbers of up to 16 views, spread over a scan."""
    return range(0, views, -(-views // MOST_VIEWS))


def unexplained(
    A: Projector,
    line_integrals: NDArray[np.float32],
    volume: Singles,
    transmission: NDArray[np.float32],
    mask: Mask | None = None,
    photons: NDArray[np.float64] | None = None,
    predicted: Singles | None = None,
) -> Unexplained | None:
    """Return what a volume leaves unexplained in ``compared_views``; None if the noise is unknown.

    Args:
        A: the projector.
        line_integrals: p that the volume was made from, (views, rows, columns).
        volume: the volume, (z, y, x).
        transmission: I/I0 as measured, (views, rows, columns): the share of the photons that is
            left, whatever was done to the line integrals.
        mask: True where a pixel counts, (rows, columns) or (views, rows, columns).
        photons: photons of a pixel in the free beam, (views,); without them, air shows the noise.
        predicted: line integrals of these views through the volume and what lies around it, (views,
            rows, columns); by default through the volume alone.
    """
    seen = noise_in_air(line_integrals, mask, photons)
    if seen is None:
        return None
    views = np.array(compared_views(len(A)))
    part = A[list(compared_views(len(A)))]
    measured = np.stack([masked_image(line_integrals, int(view), mask) for view in views])
    counts = counting_rays(part, mask if mask is None or mask.ndim == 2 else mask[views])[0]
    if not measured[counts].any():
        return None
    predicted = part(volume) if predicted is None else predicted
    variance = signal = left = 0.0
    for view, image, there, shown in zip(views, measured, counts, predicted, strict=True):
        left += float(np.square(image[there] - shown[there], dtype=np.float64).sum())
        passed = np.clip(transmission[view][there], math.exp(-DARKEST), 1, dtype=np.float64)
        variance += float((1 / passed).sum()) * float(seen.in_air[view]) ** 2
        signal += float(np.square(image[there], dtype=np.float64).sum())
    noise = variance / signal
    path = math.sqrt(signal / int(counts.sum())) / max(typical_attenuation(volume), 1e-30)
    edges = PER_VOXEL * float(A.grid.voxel.mean()) / path
    share = math.sqrt(max(left / signal - noise, 0.0))
    return Unexplained(share, math.sqrt(noise), min(edges, 1.0))


def typical_attenuation(volume: Singles) -> float:
    """Return the attenuation of the material that most of the attenuation lies in, 1/mm."""
    first = second = 0.0
    for plane in volume:
        dense = np.maximum(plane, 0, dtype=np.float64)
        first, second = first + float(dense.sum()), second + float(np.square(dense).sum())
    return second / first if first else 0.0
