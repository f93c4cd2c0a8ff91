"""Total variation lowered slab by slab, for engines without a kernel of their own."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import Floats

FEWEST_PLANES, SLAB_SHARE = 64, 0.13
"""Smallest number of planes denoised at a time, and their share of the volume.

The share includes the planes around them; the iteration holds six slabs of this size.
"""


def lower_in_slabs(
    kernels: Any,
    x: NDArray[np.float32],
    inverse: Floats,
    radius: float,
    step: float,
    floor: np.float32,
    steps: int,
) -> None:
    """Lower the total variation of ``x`` with an engine's kernels, in slabs of planes.

    Each slab has as many planes around it as its result depends on: the result is as for the whole
    volume, to the last bit. ``engine.Kernels.lower`` describes the arguments.
    """
    around = steps + 2
    below = x[:0].copy()
    planes = max(FEWEST_PLANES, int(SLAB_SHARE * len(x)) - 2 * around)
    for first in range(0, len(x), planes):
        last = min(first + planes, len(x))
        slab = np.concatenate([below, x[first : min(last + around, len(x))]])
        lowered = np.empty_like(slab)
        held, lowering = kernels.hold(slab), kernels.hold(lowered)
        weight = kernels.hold(np.ones_like(slab))
        dual = kernels.hold(np.zeros((3, *slab.shape), np.float32))
        for _ in range(steps):
            kernels.primal(held, weight, dual, inverse, floor, lowering)
            kernels.ascend(lowering, weight, inverse, radius, step, dual)
        kernels.primal(held, weight, dual, inverse, floor, lowering)
        kernels.bring(lowering, lowered)
        own = slice(len(below), len(below) + last - first)
        below = slab[max(own.stop - around, 0) : own.stop].copy()
        x[first:last] = lowered[own]
        del slab, lowered, held, lowering, weight, dual  # free memory for the next slab
