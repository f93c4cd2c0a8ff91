"""What a choice of views is worth: measures, weighed against each other and kept within limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.errors import InputError
from twinct.geometry import Floats, lock


class Measure(Protocol):
    """A figure of a choice of views; ``Detectability`` is one."""

    def added(self, chosen: Sequence[int], candidates: Sequence[int]) -> Floats:
        """The figure of a choice with one more view, for each of some candidates."""
        ...


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
    """Mean over the views of what each has by itself, such as dose, or length in metal.

    Attributes:
        each: of each candidate, (candidates,).
    """

    each: Floats

    def __init__(self, each: ArrayLike) -> None:
        """Copy and freeze.

        Raises:
            InputError: something that is no number.
        """
        object.__setattr__(self, "each", np.array(each, dtype=np.float64))
        if not np.isfinite(self.each).all():
            raise InputError("what a view costs must be a number for each candidate")
        lock(self, "each")

    def added(self, chosen: Sequence[int], candidates: Sequence[int]) -> Floats:
        """See ``Measure``."""
        return (self.each[list(chosen)].sum() + self.each[list(candidates)]) / (len(chosen) + 1)


@dataclass(frozen=True, eq=False)
class Goal:
    """A measure with what it counts for.

    Attributes:
        name: what messages and reports call it.
        measure: of a choice.
        weight: how much a change by ``unit`` is worth; negative where less is better.
        unit: what the measure is counted in, such as that of views spread evenly.
        at_most: limit of a ``Mean``, None: there is none.
    """

    name: str
    measure: Measure
    weight: float
    unit: float = 1.0
    at_most: float | None = None

    def __post_init__(self) -> None:
        """Check.

        Raises:
            InputError: a limit that cannot be kept to view by view, or a unit of 0.
        """
        if self.at_most is not None and not isinstance(self.measure, Mean):
            raise InputError(f"{self.name}: only a mean over the views can have a limit")
        if not self.unit > 0:
            raise InputError(f"{self.name}: it is counted in units of {self.unit:g}")

    def of(self, views: Sequence[int]) -> float:
        """The measure of a choice."""
        return float(self.measure.added(list(views)[:-1], list(views)[-1:])[0])

    def room(
        self, number: int, chosen: Sequence[int], free: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """What a further view may cost so that the cheapest others still make up the number.

        Returns:
            (candidates,): whether each may be taken.
        """
        assert isinstance(self.measure, Mean) and self.at_most is not None
        each, left = self.measure.each[: len(free)], number - len(chosen) - 1
        budget = self.at_most * number - each[list(chosen)].sum() + 1e-9 * abs(self.at_most)
        cheapest = np.sort(each[free])
        rest = cheapest[:left].sum()
        # A candidate that is among the cheapest itself makes room for the next of them.
        among = each <= (cheapest[left - 1] if left else -np.inf)
        following = cheapest[left] if left < len(cheapest) else np.inf
        needed = np.where(among, rest + following, rest + each)
        return needed <= budget
