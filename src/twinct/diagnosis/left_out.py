"""Views that a short reconstruction from the others predicts: they judge how a scan was stated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twinct.geometry import Floats
from twinct.recon.checks import Mask
from twinct.recon.engine import Singles
from twinct.recon.projector import Projector
from twinct.recon.sart import sart

PASSES, RELAXATION = 3, 0.5
"""Of the short reconstructions by SART."""


@dataclass(frozen=True, eq=False)
class LeftOut:
    """Every other view, predicted by the rest.

    Attributes:
        volume: the volume of the others, (z, y, x), 1/mm.
        squares: sum of squares of p - A x in each predicted view, (views,).
        residual_rel: root mean square of p - A x, relative to that of p.
    """

    volume: Singles
    squares: Floats
    residual_rel: float


def left_out(A: Projector, p: Singles, counts: Mask | None = None) -> LeftOut:
    """Reconstruct the views 0, 2, 4, ..., and predict the others.

    Args:
        A: the projector, with coarse pixels and voxels.
        p: line integrals, (views, rows, columns).
        counts: True where a pixel counts, (views, rows, columns).
    """
    some, others = slice(0, None, 2), slice(1, None, 2)
    mask = None if counts is None else counts[some]
    volume = sart(
        A[some], p[some], iterations=PASSES, relaxation=RELAXATION, nonnegative=True, mask=mask
    ).array
    held = p[others]
    off = held - A[others](volume)
    if counts is not None:
        off, held = off * counts[others], held * counts[others]
    squares = np.square(off, dtype=np.float64).sum(axis=(1, 2))
    whole = max(float(np.square(held, dtype=np.float64).sum()), 1e-30)
    return LeftOut(volume, squares, float(np.sqrt(squares.sum() / whole)))
