"""Stopping rule without ground truth: passes end with the volume nearest to a sharper version.

Errors of ``sart`` fall while edges form. They then rise as voxels take up signals from outside the
specimen: noise, errors of the poses and, above all, effects that no volume explains, such as
ringing at edges and truncation. All views share these effects, so that neither omitted views nor
the difference between two halves of a scan reveal them. The volume itself reveals them, compared
with its version of a few materials with sharp borders: this version has no rings and no noise, and
its edges are the edges that passes still have to form.

That version misleads where a volume is not made of two kinds of material, such as bone, tissue and
air, or where one kind is cut off. So no pass is too many while the residual still falls much. The
noise, as far as air in the projections shows it, is taken out of the residual first: no pass lowers
it much.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from typing import Any, Literal, get_args

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.core.foreign_text import quoted
from twinct.core.threads import threads
from twinct.recon.checks import Checks, Mask, counting_rays, remainder
from twinct.recon.engine import Singles
from twinct.recon.order import spread_order
from twinct.recon.projector import Projector
from twinct.recon.steps import sum_of_squares

StopName = Literal["auto"]

WINDOW = 25
"""Edge of the window in which values of one side are averaged, in voxels.

It is wider than the rings at edges, and narrower than the drifts of values: hardening, truncation,
tissues beside bone.
"""

NEAR = 2
"""Distance from the denser side within which passes are judged, in voxels: edges lie there."""

BLOCK, MOST_THREADS = 64, 2
"""Edge of the blocks that are judged at a time, in voxels, and number of threads.

The threads need 60 MB at most, whatever the volume, with the voxels around their blocks.
"""

VOLUMES = 1.3
"""Peak memory of ``BestPass`` in volumes: the previous volume, and every eighth voxel."""

MUCH_LESS = 0.915
"""Ratio of the residuals after and before a pass below which the pass was not too many.

From the tuning half of the zoo (benchmarks/zoo.py).
"""

LEAST_REST = 0.5
"""Least ratio of the rest of the residual to the noise: a smaller one is uncertain."""

MOST_VIEWS = 16
"""Number of views in which the residual is computed."""

Box = tuple[slice, ...]

Residual = Callable[[Singles], float]


class BestPass:
    """Monitor of the volumes after each pass, for as long as they improve.

    Attributes:
        passes: number of passes that made the best volume so far.
        watches: whether it judges any pass.
    """

    def __init__(self, stop: StopName | None, residual: Residual | None = None) -> None:
        """Start with no passes; if ``stop`` is None, monitor nothing and never end.

        Args:
            stop: the rule.
            residual: root mean square of p - A x of a volume; if it is given, no pass is the last
                that lowers it much.
        """
        self.passes = 0
        self.watches = stop is not None
        self._best: Singles | None = None
        self._residual, self._least = residual, math.inf

    @classmethod
    def checked(
        cls, checks: Checks, stop: StopName | None, residual: Residual | None = None
    ) -> BestPass:
        """Build from an argument; report a problem to ``checks``."""
        if stop is not None and stop not in get_args(StopName):
            checks.problems.append(f"stop is {quoted(stop)}; it must be auto or None")
        return cls(stop, residual)

    @property
    def volumes(self) -> float:
        """Peak memory, in volumes."""
        return VOLUMES if self.watches else 0.0

    @property
    def extras(self) -> dict[str, int]:
        """Extras of a volume: the number of passes, if monitored."""
        return {"passes": self.passes} if self.watches else {}

    def start(self, x: Singles) -> None:
        """Store the volume with which the first pass is compared."""
        if self.watches:
            self._best = x.copy()
            self._least = self._residual(x) if self._residual else math.inf

    def is_over(self, x: Singles) -> bool:
        """Return True if a pass made the volume worse, and restore the previous volume in ``x``.

        Args:
            x: volume after the pass, (z, y, x).
        """
        if not self.watches:
            return False
        residual = self._residual(x) if self._residual else math.inf
        if self._best is None:
            self._best = x.copy()
        elif self._is_worse(self._best, x, residual):
            np.copyto(x, self._best)
            return True
        else:
            np.copyto(self._best, x)
        self._least = residual
        self.passes += 1
        return False

    def _is_worse(self, before: Singles, after: Singles, residual: float) -> bool:
        """Judge a pass by the residual, and where that leaves it open by ``error_change``."""
        if residual < MUCH_LESS * self._least < math.inf:
            return False
        return error_change(before, after) > 0


def residual_in(A: Projector, p: NDArray[Any], mask: Mask | None) -> Residual:
    """Return a function of a volume: the root mean square of p - A x in up to 16 spread views.

    The noise that air shows is taken out, as far as ``LEAST_REST`` is left.
    """
    from twinct.recon.air import known_noise  # only here: scenarios need the settings alone
    from twinct.recon.regularisation import deviation_and_range

    seen = known_noise(p, mask, None)
    noise = deviation_and_range(p, seen, mask)[0] ** 2 if seen else 0.0
    views = [int(view) for view in spread_order(len(A))[:: -(-len(A) // MOST_VIEWS)]]
    part = A[views]

    def residual(x: Singles) -> float:
        rest = remainder(part, x, p, views, mask)
        counts = counting_rays(part, mask if mask is None or mask.ndim == 2 else mask[views])[0]
        square = sum_of_squares(rest * counts) / max(int(counts.sum()), 1)
        return math.sqrt(max(square - noise, noise * LEAST_REST**2))

    return residual


def error_change(before: Singles, after: Singles) -> float:
    """Estimate the growth of the sum of squared errors near edges from one volume to another.

    With d = after - before and m their mean, the sum of squared differences from any truth t
    changes by 2 <d, m - t>. The version of m with sharp borders (``_from_sharper``) stands for t:
    borders made of m are equally near to both volumes. The estimate covers voxels within ``NEAR``
    voxels of material denser than Otsu's threshold (1979), in the middle three quarters along each
    axis, which most views see. It is 0 where nothing stands out.

    Args:
        before: a volume, (z, y, x).
        after: another volume of this shape.

    Returns:
        Growth in the unit of the volumes, squared, times voxels.
    """
    inner = tuple(slice(n // 8, n - n // 8) for n in before.shape)
    few = tuple(slice(one.start, one.stop, 2) for one in inner)
    sample = (before[few] + after[few]) / 2
    if not np.ptp(sample) > 0:
        return 0.0
    from skimage import filters as skimage_filters

    filters: Any = skimage_filters  # it comes without types
    threshold = float(filters.threshold_otsu(sample.ravel()))

    def judged(part: Box) -> float:
        around, own = _widened(part, before.shape)
        mean = (before[around] + after[around]) * np.float32(0.5)
        off, near = _from_sharper(mean, after[around], threshold)
        counts = near[own]
        change = (after[part] - before[part])[counts]
        return 2 * float(np.sum(change * off[own][counts], dtype=np.float64))

    # scipy's filters release the interpreter lock. The sums are added in the order of the
    # blocks: the number of threads does not change the last bit.
    with ThreadPoolExecutor(min(MOST_THREADS, threads())) as pool:
        return sum(pool.map(judged, _blocks(inner)))


def _blocks(box: Box) -> Iterator[Box]:
    """Yield the blocks of a box."""
    yield from product(
        *(
            [slice(i, min(i + BLOCK, one.stop)) for i in range(one.start, one.stop, BLOCK)]
            for one in box
        )
    )


def _widened(part: Box, shape: tuple[int, ...]) -> tuple[Box, Box]:
    """Return a box with all voxels around it that affect it, and the place of the box in there."""
    reach = WINDOW // 2 + 1
    around = tuple(
        slice(max(one.start - reach, 0), min(one.stop + reach, n))
        for one, n in zip(part, shape, strict=True)
    )
    own = tuple(
        slice(one.start - wide.start, one.stop - wide.start)
        for one, wide in zip(part, around, strict=True)
    )
    return around, own


def _from_sharper(
    m: Singles, after: Singles, threshold: float
) -> tuple[Singles, NDArray[np.bool_]]:
    """Return the difference of a volume from its version with sharp borders, and its mask.

    A border lies where the volume crosses the threshold, at (m - threshold) / g voxels from a
    voxel's centre, with g the slope. This distance plus one half is the share of the denser side in
    the voxel. Each side has the mean value of the later volume over the surrounding voxels that
    are entirely on this side: single values that still change look like correct ones.
    """
    dense = (m - np.float32(threshold)) / _slope(m)
    dense += np.float32(0.5)
    np.clip(dense, 0, 1, out=dense)
    near = scipy.ndimage.maximum_filter(dense > 0.5, 2 * NEAR + 1)
    off = m.copy()
    for share in (dense, 1 - dense):
        alone = (share == 1).astype(np.float32)
        number = scipy.ndimage.uniform_filter(alone, WINDOW)
        alone *= after
        value = scipy.ndimage.uniform_filter(alone, WINDOW)
        known = number > 0.5 / WINDOW**3
        near &= known | (share == 0)
        np.divide(value, number, out=value, where=known)
        value *= share
        off -= value
    return off, near


def _slope(m: Singles) -> Singles:
    """Return the slope of each voxel from the steeper difference along each axis; above 0.

    The steeper difference leaves a border that is already sharp as it is.
    """
    square = np.full_like(m, np.finfo(np.float32).tiny)
    for axis in range(3):
        step = np.square(np.diff(m, axis=axis))
        steeper = np.zeros_like(m)
        below, above = (np.moveaxis(steeper, axis, 0)[part] for part in (slice(-1), slice(1, None)))
        step = np.moveaxis(step, axis, 0)
        np.copyto(below, step)
        np.maximum(above, step, out=above)
        square += steeper
    return np.sqrt(square, out=square)
