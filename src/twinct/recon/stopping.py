"""A stopping rule that needs no truth: passes end with the volume nearest to a sharper one.

Errors of ``sart`` fall while edges are made, then rise with what voxels take up that is not in the
specimen: noise, errors of the poses, and above all what no volume explains, ringing at edges and
truncation. All views have the latter in common, so that neither views left out nor the
difference of two halves of a scan see it. What does is the volume itself, held against what it
would be of few materials with sharp borders: there are no rings and no noise in that, and its edges
are those that passes still have to make.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from typing import Any, Literal, get_args

import numpy as np
import scipy
from numpy.typing import NDArray

from twinct.recon.checks import Checks
from twinct.recon.engine import Singles
from twinct.threads import threads

StopName = Literal["auto"]

WINDOW = 25
"""Voxels along an axis over which values of a side are averaged. More than the rings at edges are
wide, and less than values drift over: hardening, truncation, tissues beside bone."""

NEAR = 2
"""Voxels about the denser side within which passes are judged: edges lie there."""

BLOCK, MOST_THREADS = 64, 2
"""Voxels along each axis that are judged at a time, beside those around them, and by how many
threads: what these take is 60 MB at most, whatever the volume."""

VOLUMES = 1.3
"""What ``BestPass`` holds at its peak: the volume before, and every eighth voxel."""

Box = tuple[slice, ...]


class BestPass:
    """Watches the volumes that passes make, for as long as they get better.

    Attributes:
        passes: those that made the best volume so far.
    """

    def __init__(self, stop: StopName | None) -> None:
        """With None it watches nothing, and is never over."""
        self.passes = 0
        self._watches = stop is not None
        self._best: Singles | None = None

    @classmethod
    def checked(cls, checks: Checks, stop: StopName | None) -> BestPass:
        """Of an argument; a problem goes to ``checks``."""
        if stop is not None and stop not in get_args(StopName):
            checks.problems.append(f"stop is {stop!r}: auto or None needed")
        return cls(stop)

    @property
    def volumes(self) -> float:
        """Memory that it takes at its peak, in volumes."""
        return VOLUMES if self._watches else 0.0

    @property
    def told(self) -> dict[str, int]:
        """What a volume's extras say of it."""
        return {"passes": self.passes} if self._watches else {}

    def start(self, x: Singles) -> None:
        """Take a volume for the first pass to be held against."""
        if self._watches:
            self._best = x.copy()

    def is_over(self, x: Singles) -> bool:
        """Whether a pass has made the volume worse than it was; ``x`` is then as it was.

        Args:
            x: after the pass, (z, y, x).
        """
        if not self._watches:
            return False
        if self._best is None:
            self._best = x.copy()
        elif error_change(self._best, x) > 0:
            np.copyto(x, self._best)
            return True
        else:
            np.copyto(self._best, x)
        self.passes += 1
        return False


def error_change(before: Singles, after: Singles) -> float:
    """By how much the sum of squared errors near edges grew from one volume to another, estimated.

    With d = after - before and m their mean, the sum of squared differences to any truth t changes
    by 2 <d, m - t>. For t stands what m would be with sharp borders (``_from_sharper``): borders
    made of m are as near to the one volume as to the other. Judged is within ``NEAR`` voxels of
    what is denser than Otsu's threshold (1979), in the middle three quarters along each axis, which
    most views see. 0 where nothing stands out.

    Args:
        before: a volume, (z, y, x).
        after: another of this shape.

    Returns:
        In the unit of the volumes, squared, times voxels.
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

    # scipy's filters let go of the interpreter lock. The sums are added in the order of the blocks:
    # the number of threads does not change the last bit.
    with ThreadPoolExecutor(min(MOST_THREADS, threads())) as pool:
        return sum(pool.map(judged, _blocks(inner)))


def _blocks(box: Box) -> Iterator[Box]:
    """A box in parts."""
    yield from product(
        *(
            [slice(i, min(i + BLOCK, one.stop)) for i in range(one.start, one.stop, BLOCK)]
            for one in box
        )
    )


def _widened(part: Box, shape: tuple[int, ...]) -> tuple[Box, Box]:
    """A box with all around it that its judgement looks at, and the box within that."""
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
    """How far a volume is from what it would be with sharp borders, and where that counts.

    A border lies where the volume crosses the threshold: at (m - threshold) / g voxels from a
    voxel's middle, with g the slope. So much, and half, of the voxel is of the denser side. Either
    side has the mean value of the voxels about that are of it alone, that of the later volume:
    values on their way are not told from right ones by themselves.
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
    """The steeper of both differences to the neighbours, along all axes, per voxel; above 0.

    The steeper, so that a border which is sharp already stays as it is.
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
