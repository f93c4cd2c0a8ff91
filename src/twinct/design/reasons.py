"""The question why the arms cannot take a view."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from twinct.design.bench import Bench
from twinct.design.questions import Question
from twinct.geometry import Floats
from twinct.runs.remedies import held_as_well_as_can_be
from twinct.scenario import Cell


@dataclass(frozen=True, eq=False)
class Reason:
    """Why a view is dead.

    Attributes:
        view: index of the view.
        words: the problems, one sentence each; empty if both arms hold the view.
        joints: joint configuration that comes nearest to it, rad, (joints,).
    """

    view: int
    words: tuple[str, ...]
    joints: Floats


@dataclass(frozen=True)
class WhyDead(Question):
    """Why the arms cannot take a view, and how near they come.

    Attributes:
        view: index of the view.
    """

    view: int = 0
    subject: ClassVar[str] = "reason"

    def answered(self, bench: Bench) -> Reason:
        """Return the reason."""
        scenario = bench.scenario(self.source)
        if not isinstance(scenario.cell, Cell):
            return Reason(self.view, (), np.zeros(0))
        held = held_as_well_as_can_be(bench.builder(scenario), self.view)
        return Reason(self.view, held.words, np.asarray(held.joints))
