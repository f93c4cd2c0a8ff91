"""Trials that repeat one combination of values: their means with confidence, over each axis."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from scipy.special import stdtrit

CONFIDENCE = 0.95
MOST_LINES = 6
"""Combinations of the other axes that a picture tells apart."""


@dataclass(frozen=True, eq=False)
class StudyTrial:
    """One trial of a study, as its page shows it.

    Attributes:
        trial: its number.
        axes: value on each axis, by the axis's label; None where an axis does not apply.
        seed: of the repetition.
        done: whether it has figures; else it failed.
        figures: by dotted name; None where one is not finite.
        seconds: of each stage.
        message: why it failed.
        kind: class of the error.
        report: path of its report, relative to the page; empty: none.
    """

    trial: int
    axes: Mapping[str, Any]
    seed: int | None
    done: bool
    figures: Mapping[str, float | None] = field(default_factory=dict)
    seconds: Mapping[str, float] = field(default_factory=dict)
    message: str = ""
    kind: str = ""
    report: str = ""


class Mean(NamedTuple):
    """A mean over n repetitions, and half the width of its interval; None where there is none."""

    mean: float | None
    half: float | None
    n: int


def mean_of(values: Iterable[float | None]) -> Mean:
    """Mean and Student's interval, mean +- t s / sqrt(n) with n - 1 degrees of freedom.

    Source: Student, The probable error of a mean, Biometrika 6 (1908). Values that are None do not
    count; one alone has no interval.
    """
    x = np.array([value for value in values if value is not None], dtype=np.float64)
    if not x.size:
        return Mean(None, None, 0)
    half = None
    if x.size > 1:
        quantile = stdtrit(x.size - 1, 0.5 + CONFIDENCE / 2)
        half = float(quantile * x.std(ddof=1) / math.sqrt(x.size))
    return Mean(float(x.mean()), half, x.size)


@dataclass(frozen=True, eq=False)
class Combination:
    """The trials that have the same values on all axes, in the axes' order; failed ones too."""

    values: tuple[Any, ...]
    trials: tuple[StudyTrial, ...]

    def found(self, figure: str) -> dict[int, tuple[StudyTrial, float]]:
        """Trials that have a figure, with its value, by seed or, without one, by their place."""
        told = [(one, one.figures.get(figure)) for one in self.trials if one.done]
        return {
            place if one.seed is None else one.seed: (one, value)
            for place, (one, value) in enumerate(told)
            if value is not None
        }

    def mean(self, figure: str) -> Mean:
        """Of a figure over the repetitions."""
        return mean_of(value for _, value in self.found(figure).values())


def combinations(trials: Iterable[StudyTrial], labels: Sequence[str]) -> list[Combination]:
    """Trials by their values on the axes, in the order of their first ones."""
    found: dict[str, list[StudyTrial]] = {}
    for one in sorted(trials, key=lambda one: one.trial):
        found.setdefault(_key([one.axes.get(label) for label in labels]), []).append(one)
    return [
        Combination(tuple(same[0].axes.get(label) for label in labels), tuple(same))
        for same in found.values()
    ]


def _key(values: Any) -> str:
    return json.dumps(values, sort_keys=True)


@dataclass(frozen=True, eq=False)
class Trend:
    """A figure over an axis.

    Attributes:
        lines: points (value on the axis, mean), for each combination of the other axes; all points
            are in one line without values of others where each point is of one combination, or
            where they are averaged.
        averaged: whether there were too many combinations of the others, so that each point is
            their average.
        left_out: combinations to which the axis does not apply.
    """

    lines: Sequence[tuple[tuple[Any, ...], Sequence[tuple[Any, Mean]]]]
    averaged: bool
    left_out: int

    @property
    def values(self) -> list[Any]:
        """Where there are points: numbers by size, others as they come."""
        found = list({_key(x): x for _, line in self.lines for x, _ in line}.values())
        return sorted(found) if numeric(found) else found

    @property
    def has_intervals(self) -> bool:
        """Whether any point has one."""
        return any(mean.half is not None for _, line in self.lines for _, mean in line)


def numeric(values: Iterable[Any]) -> bool:
    """Whether all are numbers."""
    return all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)


def trend(found: Sequence[Combination], axis: int, figure: str) -> Trend:
    """A figure over one axis, by the place of the axis among all."""
    having = [one for one in found if one.found(figure)]
    on_axis = [one for one in having if one.values[axis] is not None]
    by_value: dict[str, list[Combination]] = {}
    by_others: dict[str, list[Combination]] = {}
    for one in on_axis:
        by_value.setdefault(_key(one.values[axis]), []).append(one)
        by_others.setdefault(_key(_others(one, axis)), []).append(one)
    left_out = len(having) - len(on_axis)
    alone = all(len(same) == 1 for same in by_value.values())
    if not alone and len(by_others) <= MOST_LINES:
        lines = [
            (_others(same[0], axis), _in_order((c.values[axis], c.mean(figure)) for c in same))
            for same in by_others.values()
        ]
        return Trend(lines, False, left_out)
    points = _in_order((c[0].values[axis], _average(c, figure)) for c in by_value.values())
    return Trend([((), points)], not alone, left_out)


def _others(one: Combination, axis: int) -> tuple[Any, ...]:
    return one.values[:axis] + one.values[axis + 1 :]


def _in_order(points: Iterable[tuple[Any, Mean]]) -> list[tuple[Any, Mean]]:
    points = list(points)
    return sorted(points, key=lambda point: point[0]) if numeric(x for x, _ in points) else points


def _average(found: Sequence[Combination], figure: str) -> Mean:
    """Average over combinations, then over the seeds that all of them have.

    What the combinations differ by is no uncertainty: only the seeds' averages tell that.
    """
    told = [one.found(figure) for one in found]
    seeds = set(told[0]).intersection(*told[1:])
    if seeds:
        return mean_of(sum(one[seed][1] for one in told) / len(told) for seed in sorted(seeds))
    means = [value for one in found if (value := one.mean(figure).mean) is not None]
    return Mean(sum(means) / len(means), None, 0)
