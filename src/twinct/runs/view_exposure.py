"""The mAs of planned views: shared so that most is detected, the dose still within its limit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twinct.geometry import Floats, lock
from twinct.planning import Detectability, Goal, Mean, best_exposures
from twinct.scenario import ExposureSharing


@dataclass(frozen=True, eq=False)
class Shared:
    """Exposures of chosen views, and what is had with them.

    Attributes:
        exposures: of each view, in units of what all have without, mean 1, (views,).
        figures: of the goals that depend on them, by name.
        equal: the same at equal exposures.
    """

    exposures: Floats
    figures: dict[str, float]
    equal: dict[str, float]

    def __post_init__(self) -> None:
        """Freeze."""
        lock(self, "exposures")


def share_exposure(section: ExposureSharing, goals: Sequence[Goal], views: Sequence[int]) -> Shared:
    """Share the mAs among views; where the dose would exceed its limit, only a part of the way.

    Args:
        section: bounds.
        goals: detectability among them.
        views: that were chosen.
    """
    measures = {goal.name: goal for goal in goals if goal.name in ("detectability", "dose")}
    found = measures["detectability"].measure
    assert isinstance(found, Detectability)
    chosen = list(views)
    mine = Detectability(found.task, found.fisher[chosen])
    equal = np.ones(len(chosen))
    best = best_exposures(
        found, chosen, total=len(chosen), least=section.least_rel, most=section.most_rel
    )
    part, kerma = 1.0, np.zeros(len(chosen))
    if (dose := measures.get("dose")) is not None:
        assert isinstance(dose.measure, Mean)
        kerma = dose.measure.each[chosen]
        more, room = float(((best - 1) * kerma).mean()), np.inf
        if dose.at_most is not None:
            room = max(dose.at_most - float(kerma.mean()), 0.0)
        part = min(1.0, room / more) if more > 0 else 1.0
    exposures = equal + part * (best - equal)
    if mine(exposures) < mine(equal):
        exposures = equal

    def told(of: Floats) -> dict[str, float]:
        every = {"detectability": mine(of), "dose": float((of * kerma).mean())}
        return {name: value for name, value in every.items() if name in measures}

    return Shared(exposures, told(exposures), told(equal))
