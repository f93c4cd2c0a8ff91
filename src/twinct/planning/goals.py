"""What a choice of views is worth: measures, weighed against each other and kept within limits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinct.errors import InputError
from twinct.geometry import Floats, lock
from twinct.planning.moving import TourTime


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
        at_most: limit of what no view lessens by much: a ``Mean``, or a time; None: there is none.
        at_least: what a whole choice must have; None: anything.
    """

    name: str
    measure: Measure
    weight: float
    unit: float = 1.0
    at_most: float | None = None
    at_least: float | None = None

    def __post_init__(self) -> None:
        """Check.

        Raises:
            InputError: a limit that cannot be kept to view by view, or a unit of 0.
        """
        if self.at_most is not None and not isinstance(self.measure, (Mean, TourTime)):
            raise InputError(f"{self.name}: only a mean over the views or a time can have a limit")
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
        assert self.at_most is not None
        if not isinstance(self.measure, Mean):  # it only grows
            allowed = free.copy()
            allowed[free] = self.measure.added(chosen, np.flatnonzero(free).tolist()) <= (
                self.at_most + 1e-9 * abs(self.at_most)
            )
            return allowed
        each, left = self.measure.each[: len(free)], number - len(chosen) - 1
        budget = self.at_most * number - each[list(chosen)].sum() + 1e-9 * abs(self.at_most)
        cheapest = np.sort(each[free])
        rest = cheapest[:left].sum()
        # A candidate that is among the cheapest itself makes room for the next of them.
        among = each <= (cheapest[left - 1] if left else -np.inf)
        following = cheapest[left] if left < len(cheapest) else np.inf
        needed = np.where(among, rest + following, rest + each)
        return needed <= budget


def worth_of(goals: Sequence[Goal], views: Sequence[int]) -> float:
    """What a choice is worth."""
    return sum(goal.weight * goal.of(views) / goal.unit for goal in goals if goal.weight)


def best_added(
    goals: Sequence[Goal],
    candidates: int,
    number: int,
    chosen: Sequence[int],
    instead_of: Sequence[int] | None = None,
) -> tuple[int | None, float]:
    """The view that adds most to a choice, and what the choice is worth with it.

    Args:
        goals: what counts.
        candidates: how many there are.
        number: of views that the choice will have: the limits are those of all of them.
        chosen: so far.
        instead_of: the whole choice that one with the view replaces: it has no less of what there
            must be enough of, unless it still has enough.

    Returns:
        None where no view keeps within the limits.
    """
    free = np.ones(candidates, np.bool_)
    free[list(chosen)] = False
    may = free.copy()
    for goal in goals:
        if goal.at_most is not None:
            may &= goal.room(number, chosen, free)
    views = np.flatnonzero(may).tolist()
    if not views:
        return None, -np.inf
    worth: Floats = np.zeros(len(views))
    for goal in goals:
        if goal.weight or goal.at_least is not None:
            figures = goal.measure.added(chosen, views)
            worth = worth + goal.weight * figures / goal.unit
            if goal.at_least is not None and instead_of is not None:
                worth[figures < min(goal.at_least, goal.of(instead_of))] = -np.inf
    best = int(worth.argmax())
    return views[best], float(worth[best])
