"""Distribution of the mAs over planned views for detectability, within the dose limit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twinct.geometry import Floats, lock
from twinct.scenario import ExposureSharing
from twinct.view_planning import Detectability, Goal, Mean, best_exposures


@dataclass(frozen=True, eq=False)
class Shared:
    """Exposures of chosen views, and their figures of merit.

    Attributes:
        exposures: exposure of each view relative to equal exposures, mean 1, (views,).
        figures: figures of the goals that depend on exposures, by name.
        equal: these figures at equal exposures.
    """

    exposures: Floats
    figures: dict[str, float]
    equal: dict[str, float]

    def __post_init__(self) -> None:
        """Make the exposures read-only."""
        lock(self, "exposures")


def share_exposure(section: ExposureSharing, goals: Sequence[Goal], views: Sequence[int]) -> Shared:
    """Distribute the mAs over views; go only part of the way if the dose limit requires it.

    Args:
        section: bounds of the exposures.
        goals: goals of the task, with detectability.
        views: the chosen views.
    """
    measures = {goal.name: goal for goal in goals if goal.name in ("detectability", "dose")}
    detectability = measures["detectability"].measure
    assert isinstance(detectability, Detectability)
    chosen = list(views)
    mine = Detectability(detectability.task, detectability.fisher[chosen])
    equal = np.ones(len(chosen))
    best = best_exposures(
        detectability, chosen, total=len(chosen), least=section.least_rel, most=section.most_rel
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

    def figures(of: Floats) -> dict[str, float]:
        every = {"detectability": mine(of), "dose": float((of * kerma).mean())}
        return {name: value for name, value in every.items() if name in measures}

    return Shared(exposures, figures(exposures), figures(equal))
