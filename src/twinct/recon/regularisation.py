"""Strength of the total variation from the noise of the line integrals.

The gradient of the data term at a voxel of edge a, from V views with pixels of pitch q (at the
grid) and noise s, has the standard deviation s sqrt(V) a^2 / q, since a^2 / q^2 rays of each view
cross the voxel. Relative to the mean curvature of the data term, V S / q^2 for rays of length S in
the grid, it is s q a^2 / (sqrt(V) S). The total variation opposes it with strength * a^2 at each of
the voxel's faces. So the strength is in proportion to s q / (sqrt(V) S), a pure number, in whatever
voxels.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.recon.air import DARKEST, KnownNoise
from twinct.recon.checks import Mask, mask_of, masked_image
from twinct.recon.projector import Projector

PER_NOISE = 3.0
"""Strength per s q / (sqrt(V) S); from ``fista_tv`` at its best on the zoo (bench_prior_zoo.py)."""

MOST_VIEWS = 16
"""Number of views from which the range is taken."""


def deviation_and_range(
    p: NDArray[Any], seen: KnownNoise, mask: Mask | None
) -> tuple[float, float]:
    """Return the root mean square of the noise of line integrals, and their largest per cent.

    Args:
        p: line integrals, (views, rows, columns).
        seen: noise in the free beam.
        mask: True where a pixel counts.
    """
    variances: list[float] = []
    most: list[float] = []
    step = -(-len(p) // MOST_VIEWS)
    for view, deviation in enumerate(seen.in_air):
        image, good = masked_image(p, view, mask), mask_of(mask, view)
        counts = image if good is None else image[good]
        if counts.size:
            mean = np.exp(np.clip(counts, 0, DARKEST)).mean(dtype=np.float64)
            variances.append(float(mean) * float(deviation) ** 2)
            if view % step == 0:
                most.append(float(np.percentile(counts, 99)))
    if not variances:
        return 0.0, 0.0
    return math.sqrt(sum(variances) / len(variances)), sum(most) / max(len(most), 1)


def strength_of_noise(A: Projector, p: NDArray[Any], seen: KnownNoise, mask: Mask | None) -> float:
    """Return the strength of the total variation for photon noise.

    Args:
        A: the projector.
        p: line integrals, (views, rows, columns).
        seen: noise in the free beam.
        mask: True where a pixel counts.
    """
    return strength_for(A, deviation_and_range(p, seen, mask)[0])


def strength_for(A: Projector, deviation: float) -> float:
    """Return the strength of the total variation for noise of this deviation in all rays."""
    lengths = A[:: -(-len(A) // MOST_VIEWS)].chords()
    inside = lengths > 0
    mean_length = float(lengths[inside].mean()) if inside.any() else float(A.grid.size_mm.mean())
    return float(PER_NOISE * deviation * _pitch(A) / (math.sqrt(len(A)) * mean_length))


def _pitch(A: Projector) -> float:
    """Return the mean pixel pitch, seen from the source at the middle of the grid, mm."""
    geometry, middle = A.geometry, A.grid.world_from_grid.position
    far = np.linalg.norm(geometry.detector - geometry.source, axis=1)
    near = np.linalg.norm(middle - geometry.source, axis=1)
    larger: float = (near / far).mean()
    panel = geometry.panel
    pitch = math.sqrt(panel.pitch_u * panel.pitch_v)
    return larger * pitch
