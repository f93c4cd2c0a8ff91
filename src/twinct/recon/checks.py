"""Checks that every algorithm makes before it starts; all problems are reported together."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.core.errors import InputError
from twinct.core.foreign_text import quoted
from twinct.recon.engine import Singles
from twinct.recon.projector import Projector

Mask = NDArray[np.bool_]


class Checks:
    """Collector of problems with the arguments; ``done`` raises them.

    Each check returns the argument in the form that the kernels take, or any value if it is wrong.
    """

    def __init__(self, range_shape: tuple[int, ...]) -> None:
        """Start without problems.

        Args:
            range_shape: (views, rows, columns) of the geometry.
        """
        self.range_shape = range_shape
        self.problems: list[str] = []

    def done(self) -> None:
        """Raise InputError with one sentence per problem unless there is none."""
        if self.problems:
            raise InputError(self.problems)

    def _mask(self, mask: ArrayLike | None) -> Mask | None:
        """Return the mask, True where a pixel counts, (rows, columns) or (views, rows, columns)."""
        if mask is None:
            return None
        array = np.asarray(mask)
        allowed = (self.range_shape[1:], self.range_shape)
        if array.dtype != np.bool_:
            problem = (
                f"the mask has dtype {array.dtype}; it must be bool, True where a pixel counts"
            )
        elif array.shape not in allowed:
            problem = (
                f"the mask has shape {array.shape}; it must be {allowed[0]} (rows, columns) or "
                f"{allowed[1]} (views, rows, columns)"
            )
        elif not array.any():
            problem = "the mask is False everywhere: no pixel would count"
        else:
            return array
        self.problems.append(problem)
        return None

    def projections(
        self, line_integrals: ArrayLike, mask: ArrayLike | None
    ) -> tuple[NDArray[Any], Mask | None]:
        """Return the line integrals, finite wherever a pixel counts, and the mask of pixels."""
        pixels, p = self._mask(mask), np.asarray(line_integrals)
        if p.shape != self.range_shape:
            self.problems.append(
                f"the projections have shape {p.shape}: the geometry needs {self.range_shape} "
                "(views, rows, columns)"
            )
            return p, pixels
        for view, image in enumerate(p):
            bad = ~np.isfinite(image)
            if pixels is not None:
                bad &= mask_of(pixels, view)
            if count := int(np.count_nonzero(bad)):
                self.problems.append(
                    f"view {view} of the projections has {count} pixels that are NaN or infinite: "
                    "all must be finite, or left out by the mask"
                )
                break
        return p, pixels

    def weights(self, weights: ArrayLike | None, mask: Mask | None) -> NDArray[Any] | None:
        """Return the weights of the pixels, 0 or more, finite in all pixels that count."""
        if weights is None:
            return None
        before = len(self.problems)
        w, _ = self.projections(weights, mask)
        if len(self.problems) > before:
            self.problems[-1] = self.problems[-1].replace("projections", "weights")
        elif (w < 0).any() or not (w > 0).any():
            self.problems.append("the weights must be 0 or more, with at least one above 0")
        return w

    def photons(self, photons: ArrayLike | None) -> NDArray[np.float64] | None:
        """Return the photons of a pixel in the free beam, (views,), or None."""
        if photons is None:
            return None
        numbers, views = np.asarray(photons, dtype=np.float64), self.range_shape[0]
        if numbers.shape not in ((), (views,)):
            self.problems.append(
                f"photons has shape {numbers.shape}; it must be one number, or one for each of "
                f"{views} views"
            )
            return None
        if not (np.isfinite(numbers) & (numbers > 0)).all():
            self.problems.append(f"photons is {quoted(photons)}; it must be positive and finite")
        return np.broadcast_to(numbers, views)

    def stop(self, stop: object) -> None:
        """Refuse a stopping rule that does not exist."""
        if not (stop is None or (isinstance(stop, str) and stop == "auto")):
            self.problems.append(f"stop is {quoted(stop)}; it must be auto or None")

    def count(self, name: str, value: int, at_most: float = math.inf) -> int:
        """Return a whole number of at least 1."""
        limit = "" if math.isinf(at_most) else f" and at most {at_most}"
        try:
            good = not isinstance(value, bool) and int(value) == value and 1 <= value <= at_most
        except (TypeError, ValueError, OverflowError):
            good = False
        if not good:
            self.problems.append(
                f"{name} is {quoted(value)}; it must be a whole number of at least 1{limit}"
            )
            return 1
        return int(value)

    def relaxation(self, value: float) -> float:
        """Return the relaxation, between 0 and 2, both excluded."""
        if not 0 < value < 2:
            self.problems.append(f"relaxation is {quoted(value)}; it must be above 0 and below 2")
        return float(value)

    def not_negative(self, name: str, value: float) -> float:
        """Return a finite number of at least 0."""
        if not (value >= 0 and math.isfinite(value)):
            self.problems.append(
                f"{name} is {quoted(value)}; it must be a finite number of at least 0"
            )
        return float(value)

    def huber(self, value: float | None) -> float | None:
        """Return a finite number above 0, or None."""
        if value is not None and not (value > 0 and math.isfinite(value)):
            self.problems.append(
                f"huber is {quoted(value)}; it must be a finite number above 0, or None"
            )
        return value

    def start(
        self, x0: ArrayLike | None, domain_shape: tuple[int, ...], name: str = "x0"
    ) -> ArrayLike | None:
        """Return an initial volume with finite voxels, or None."""
        if x0 is None:
            return None
        x = np.asarray(x0)
        if x.shape != domain_shape:
            self.problems.append(
                f"{name} has shape {x.shape}: the grid needs {domain_shape} (z, y, x)"
            )
        elif not all(np.isfinite(plane).all() for plane in x):
            self.problems.append(f"{name} holds NaN or infinite voxels: all must be finite")
        return x


def start_volume(A: Projector, x0: ArrayLike | None, nonnegative: bool) -> Singles:
    """Return a copy of ``x0``, or zeros."""
    if x0 is None:
        return np.zeros(A.domain_shape, np.float32)
    x = np.array(x0, dtype=np.float32, order="C")
    return np.maximum(x, 0.0, out=x) if nonnegative else x


@overload
def mask_of(mask: Mask, view: int) -> Mask: ...
@overload
def mask_of(mask: None, view: int) -> None: ...
@overload
def mask_of(mask: Mask | None, view: int) -> Mask | None: ...
def mask_of(mask: Mask | None, view: int) -> Mask | None:
    """Return the mask of one view, (rows, columns)."""
    return mask if mask is None or mask.ndim == 2 else mask[view]


def masked_image(p: NDArray[Any], view: int, mask: Mask | None) -> Singles:
    """Return the line integrals of one view, float32, 0 where a pixel does not count."""
    image = np.ascontiguousarray(p[view], dtype=np.float32)
    return image if mask is None else np.where(mask_of(mask, view), image, np.float32(0.0))


def remainder(
    A: Projector, x: Singles, p: NDArray[Any], views: Iterable[int], mask: Mask | None
) -> Singles:
    """Return the line integrals of some views less A x; A is the operator of these views."""
    rest = A(x)
    for view, image in zip(views, rest, strict=True):
        np.subtract(masked_image(p, view, mask), image, out=image)
    return rest


def counting_rays(A: Projector, mask: Mask | None) -> tuple[Mask, Singles]:
    """Return the mask of rays not shorter than a voxel, and their path lengths, mm, else 0."""
    lengths = A.chords()
    counts = lengths >= np.float32(A.grid.voxel.min())
    if mask is not None:
        counts &= mask
    lengths[~counts] = 0.0
    return counts, lengths
