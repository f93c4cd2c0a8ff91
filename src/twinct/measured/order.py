"""Order of the views: images that are repeated, out of order or missing, as far as a scan shows.

From view to view, the image of a turning object changes steadily: two steps change it more than
one. Small means of each image show this through noise. It is asked only where the stated poses move
on with each step, too: in scans by golden angles they do not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from hashlib import blake2b

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import ScanGeometry

Floats = NDArray[np.floating]

BLOCKS = 16
"""Blocks along an edge of the small images; 1e5 of them take 100 MB."""

SHORTER = 0.6
"""Change past a view relative to the stored steps that tells it out of order: two views that were
exchanged have 0.5, noise has 1, and a steady turn 2."""

ONWARD = 1.5
"""Motion past a view relative to the steps, above which the poses move on steadily."""

FAR_OFF = 2.0
"""Steps to and from a view, relative to the steps before and after, that set it apart."""

ALIKE = 0.5
"""Difference of two views, relative to a step, below which both are in one place."""

FEWEST = 8
"""Smallest number of views whose order is judged."""

MOST_LISTED = 5
"""Largest number of views in a sentence."""


@dataclass(eq=False)
class ViewOrder:
    """Small images and digests of a scan's views.

    Attributes:
        views: numbers of the views among the stored images.
    """

    views: list[int] = field(default_factory=list)
    _small: list[NDArray[np.float32]] = field(default_factory=list)
    _digests: list[bytes] = field(default_factory=list)

    def add(
        self, view: int, stored: NDArray[np.generic], transmission: NDArray[np.float64]
    ) -> None:
        """Count one more view: its number, its image as stored, and as transmission."""
        self.views.append(view)
        self._digests.append(blake2b(stored.tobytes(), digest_size=12).digest())
        self._small.append(_means(transmission))

    def sentences(self, geometry: ScanGeometry) -> list[str]:
        """Return one sentence for each doubt about the order, for the views' stated poses."""
        poses = np.concatenate([geometry.source, geometry.detector], axis=1)
        result = self._repeated(poses)
        if result or len(self.views) < FEWEST:
            return result
        images = np.array([one.ravel() for one in self._small])
        return self._out_of_order(images, poses) + self._closed(images, poses)

    def _repeated(self, poses: Floats) -> list[str]:
        first: dict[bytes, int] = {}
        pairs: list[tuple[int, int]] = []
        for index, digest in enumerate(self._digests):
            before = first.setdefault(digest, index)
            if before != index and not np.allclose(poses[before], poses[index]):
                pairs.append((before, index))
        if not pairs:
            return []
        names = listed([f"{self.views[b]} like {self.views[a]}" for a, b in pairs])
        return [
            f"images repeat earlier ones to the last bit: {names}: did the detector or a copy "
            "store them twice? Leave them out, with their angles"
        ]

    def _out_of_order(self, images: Floats, poses: Floats) -> list[str]:
        pairs = (_past_pairs(images) < SHORTER) & (_past_pairs(poses) > ONWARD)
        if pairs.any():
            at = pairs.nonzero()[0] + 1
            names = listed([f"{self.views[v]} and {self.views[v + 1]}" for v in at])
            return [
                f"images {names} fit their neighbours better if they are exchanged: are the files "
                "out of order? They are read in the order of the numbers in their names"
            ]
        # A thin sheet seen from its edge stands apart, too; but it is like no view elsewhere.
        single = (_past_one(images) < SHORTER) & (_past_one(poses) > ONWARD) & _far_off(images)
        names = []
        for view in single.nonzero()[0] + 1:
            off = _size(images - images[view])
            step = min(off[view - 1], off[view + 1])
            off[max(view - 2, 0) : view + 3] = np.inf
            if off.min() < SHORTER * step:
                names.append(f"{self.views[view]} (like {self.views[int(off.argmin())]})")
        if not names:
            return []
        return [
            f"images differ from both neighbours, but not from a view elsewhere: {listed(names)}: "
            "are they out of order? They are read in the order of the numbers in their names"
        ]

    def _closed(self, images: Floats, poses: Floats) -> list[str]:
        """Compare the last view with the first."""
        steps = _steps(images, 1)
        step, back = min(steps[0], steps[-1]), float(_size(images[-1] - images[0]))
        moved, returned = _steps(poses, 1)[0], float(_size(poses[-1] - poses[0]))
        if step < ALIKE * float(np.median(steps)) or returned > 1.5 * moved:
            return []
        first, last = self.views[0], self.views[-1]
        alike, at_once = back < ALIKE * step, returned < ALIKE * moved
        if alike and not at_once:
            return [
                f"images {first} and {last} are alike (they differ by {back:.2g} RMS, neighbours "
                f"by {step:.2g}), but their poses are a step apart: do the angles include both "
                "ends of the turn? Then the step is the span divided by the views less one"
            ]
        if at_once:
            return [
                f"images {first} and {last} have one pose"
                + (
                    ": it counts twice; leave one out"
                    if alike
                    else f", but differ by {back:.2g} RMS, as neighbours do ({step:.2g}): is the "
                    "step of the angles the span divided by the views?"
                )
            ]
        return []


def _size(change: Floats) -> Floats:
    return np.sqrt(np.mean(change**2, axis=-1))


def _steps(values: Floats, by: int) -> Floats:
    """Return the RMS change from each view to the one some steps later."""
    return _size(values[by:] - values[:-by])


def _past_pairs(values: Floats) -> Floats:
    """Return the change with neighbouring views 1 and 2, 2 and 3, ... exchanged, relative to it."""
    one, two = _steps(values, 1), _steps(values, 2)
    return (two[:-1] + two[1:]) / np.maximum(one[:-2] + one[2:], 1e-12)


def _past_one(values: Floats) -> Floats:
    """Return the change past view 1, 2, ..., relative to the smaller change to it or from it."""
    one, two = _steps(values, 1), _steps(values, 2)
    return two / np.maximum(np.minimum(one[:-1], one[1:]), 1e-12)


def _far_off(values: Floats) -> NDArray[np.bool_]:
    """Return whether the steps to and from view 1, 2, ... are longer than those around them."""
    one = _steps(values, 1)
    before, after = np.append(one[:1], one[:-2]), np.append(one[2:], one[-1:])
    before[0], after[-1] = after[0], before[-1]
    return np.minimum(one[:-1], one[1:]) > FAR_OFF * np.maximum(before, after)


def _means(image: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return means of line integrals over blocks of an image, (blocks, blocks) or fewer."""
    rows, columns = (np.linspace(0, n, min(n, BLOCKS) + 1).astype(int) for n in image.shape)
    p = -np.log(np.maximum(image, 1e-4))
    sums = np.add.reduceat(np.add.reduceat(p, rows[:-1], axis=0), columns[:-1], axis=1)
    return (sums / np.outer(np.diff(rows), np.diff(columns))).astype(np.float32)


def listed(names: Sequence[str]) -> str:
    """Return the first of some names in words, and the number of the others."""
    more = f" and {len(names) - MOST_LISTED} more" if len(names) > MOST_LISTED else ""
    return ", ".join(names[:MOST_LISTED]) + more
