"""Measures of a choice of views: their interface, coverage, and the mean over the views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.core.errors import InputError
from twinct.geometry import Floats, lock


class Measure(Protocol):
    """Figure of a choice of views, such as ``Detectability``."""

    def added(self, chosen: Sequence[int], candidates: Sequence[int]) -> Floats:
        """Return the figure of a choice with one more view, for each of some candidates."""
        ...


def figure_of(measure: Measure, views: Sequence[int]) -> float:
    """Return the figure of a choice of at least one view."""
    return float(measure.added(list(views)[:-1], list(views)[-1:])[0])


@dataclass(frozen=True, eq=False)
class Coverage:
    """Share of the elements, such as planes through points, that any view covers.

    Attributes:
        covers: (candidates, elements).
    """

    covers: NDArray[np.bool_]

    def added(self, chosen: Sequence[int], candidates: Sequence[int]) -> Floats:
        """See ``Measure``."""
        covered = self.covers[list(chosen)].any(axis=0)
        more = self.covers[list(candidates)][:, ~covered].sum(axis=1)
        return (covered.sum() + more) / self.covers.shape[1]


@dataclass(frozen=True, eq=False)
class Mean:
    """Mean over the views of a figure of each view, such as its dose or path length in metal.

    Attributes:
        each: figure of each candidate, (candidates,).
    """

    each: Floats

    def __init__(self, each: ArrayLike) -> None:
        """Copy and freeze the figures.

        Raises:
            InputError: a figure is not a finite number.
        """
        object.__setattr__(self, "each", np.array(each, dtype=np.float64))
        if not np.isfinite(self.each).all():
            raise InputError("the cost of a view must be a finite number for each candidate")
        lock(self, "each")

    def added(self, chosen: Sequence[int], candidates: Sequence[int]) -> Floats:
        """See ``Measure``."""
        return (self.each[list(chosen)].sum() + self.each[list(candidates)]) / (len(chosen) + 1)
