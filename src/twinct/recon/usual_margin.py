"""Margin of the coarse grids of ``fast``: as narrow as the line integrals allow.

A margin has to hold what lies around the grid. If it is too narrow, the rest is pressed into the
grid; if it is wider than necessary, few rays tell its voxels apart, and their errors reach into the
grid. So a small scan is made of the real one, in pixels and voxels many times larger, and
reconstructed with margins of several widths. The narrowest one that leaves about as little of the
line integrals as a very wide one is the usual margin.

docs/reconstruction.md gives the reasons for these numbers.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.recon.checks import Mask, mask_of, masked_image
from twinct.recon.engine import Singles
from twinct.recon.levels import with_margin
from twinct.recon.order import spread_order
from twinct.recon.projector import Projector
from twinct.recon.resolution import binned
from twinct.recon.signs_beyond import signs_beyond
from twinct.recon.steps import sum_of_squares
from twinct.recon.working import WorkingVolume

AIR_BESIDE, AIR_AT_RIM = 0.002, 0.01
"""Signs that something lies beyond the grid (``SignsBeyond``) up to which there is only air."""

MARGINS, VERY_WIDE = (0.1, 0.2, 0.3), 0.6
"""Margins on each side, as shares of the grid's size, and that with which they are compared.

A margin of 0.4 would need a third more memory than ``fast`` states."""

AS_LITTLE = 1.5
"""Ratio of the residuals of two margins up to which the narrower one will do."""

VIEWS, VOXELS, PASSES = 32, 16, 4
"""Views, voxels along an axis and passes of the small scan, about."""


def usual_margin(A: Projector, p: NDArray[Any], pixels: Mask | None, factor: int) -> float:
    """Return the margin on each side, as a share of the grid's size; 0 with air around the object.

    Args:
        A: the projector, with the grid that will be reconstructed.
        p: line integrals, (views, rows, columns).
        pixels: True where a pixel counts, (rows, columns) or (views, rows, columns).
        factor: factor of the largest voxels that will get the margin.

    Raises:
        InputError: even the narrowest margin reaches behind a source.
    """
    signs = signs_beyond(A, p, pixels)
    if signs.beside <= AIR_BESIDE and signs.at_rim <= AIR_AT_RIM:
        return 0.0
    scan = _SmallScan.of(A, p, pixels)
    possible: list[float] = []
    for margin in (*MARGINS, VERY_WIDE):
        try:
            for larger in (factor, scan.factor):
                with_margin(A.geometry, A.grid, larger, margin)
        except InputError as error:
            if not possible:
                cure = "state a smaller margin of fast (reconstruction.margin), or 0"
                raise InputError(f"{one}; {cure}" for one in error.problems) from None
            break
        possible.append(margin)
    most = AS_LITTLE * scan.left_by(possible[-1])
    for margin in possible[:-1]:
        if margin == MARGINS[-1] or scan.left_by(margin) <= most:
            return margin
    return possible[-1]


@dataclass(frozen=True, eq=False)
class _SmallScan:
    """A few views of a scan in large pixels, for voxels that are larger by the same factor."""

    A: Projector
    p: Singles
    pixels: Mask | None
    factor: int

    @classmethod
    def of(cls, A: Projector, p: NDArray[Any], pixels: Mask | None) -> _SmallScan:
        factor = max(1, round(math.prod(A.domain_shape) ** (1 / 3) / VOXELS))
        few = slice(None, None, -(-len(A) // VIEWS))
        mask = pixels if pixels is None or pixels.ndim == 2 else pixels[few]
        rows, columns = (min(factor, n) for n in A.range_shape[1:])
        views = A[few].geometry.binned(rows, columns)
        return cls(A[few].on(A.grid, views), *binned(p[few], mask, (rows, columns)), factor)

    def left_by(self, margin: float) -> float:
        """Return the root of the sum of squares that a volume with a margin leaves."""
        A = self.A.on(with_margin(self.A.geometry, self.A.grid, self.factor, margin))
        work = WorkingVolume(A.kernels, np.zeros(A.domain_shape, np.float32))
        for view in PASSES * spread_order(len(A)).tolist():
            image, mask = masked_image(self.p, view, self.pixels), mask_of(self.pixels, view)
            A.update(work.held, view, image, relaxation=1.0, mask=mask, floor=0.0)
            work.changed()
        rest = self.p - A(work.array)
        if self.pixels is not None:
            rest *= self.pixels
        return math.sqrt(sum_of_squares(rest))
