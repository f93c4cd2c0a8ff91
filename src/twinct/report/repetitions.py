"""Trials that repeat one combination of values: their means with confidence, over each axis."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import scipy

CONFIDENCE = 0.95
MOST_LINES = 6
"""Combinations of the other axes that a picture tells apart."""
MOST_VALUES = 60
"""On an axis; where there are more, only a cloud of combinations is drawn."""
MOST_DOTS = 1000
"""Of a cloud."""


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
        quantile = scipy.special.stdtrit(x.size - 1, 0.5 + CONFIDENCE / 2)
        half = float(quantile * x.std(ddof=1) / math.sqrt(x.size))
    return Mean(float(x.mean()), half, x.size)


@dataclass(frozen=True, eq=False)
class Combination:
    """The trials that have the same values on all axes, in the axes' order; failed ones too.

    Attributes:
        keys: texts that are the same for the same values.
    """

    values: tuple[Any, ...]
    keys: tuple[str, ...]
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
    found: dict[tuple[str, ...], list[StudyTrial]] = {}
    for one in sorted(trials, key=lambda one: one.trial):
        keys = tuple(json.dumps(one.axes.get(label), sort_keys=True) for label in labels)
        found.setdefault(keys, []).append(one)
    return [
        Combination(tuple(same[0].axes.get(label) for label in labels), keys, tuple(same))
        for keys, same in found.items()
    ]


@dataclass(frozen=True, eq=False)
class Trend:
    """A figure over an axis.

    Attributes:
        values: on the axis: numbers by size, others as they come.
        lines: points (value, mean) for each combination of the other axes' values; one line without
            such values where there are no others, or where they are averaged.
        cloud: (value, mean) of each combination by itself, or of ``MOST_DOTS`` of them evenly.
        averaged: whether there were too many combinations of the others, so that points of the
            line are their averages.
        others: places of the other axes that vary at one value of this.
        along: places of those that vary with this one alone, so that points show their effects too.
        joined: whether neighbours are values in order, not one draw of many axes each.
        left_out: combinations to which the axis does not apply.
        had: combinations to which it does.
    """

    values: Sequence[Any]
    lines: Sequence[tuple[tuple[Any, ...], Sequence[tuple[Any, Mean]]]]
    cloud: Sequence[tuple[Any, float]]
    averaged: bool
    others: Sequence[int]
    along: Sequence[int]
    joined: bool
    left_out: int
    had: int

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
    for one in on_axis:
        by_value.setdefault(one.keys[axis], []).append(one)
    values = [same[0].values[axis] for same in by_value.values()]
    if numeric(values):
        on_axis.sort(key=lambda one: one.values[axis])
        by_value = dict(sorted(by_value.items(), key=lambda item: item[1][0].values[axis]))
        values.sort()
    rest = [place for place in range(len(on_axis[0].keys) if on_axis else 0) if place != axis]
    others = [
        place
        for place in rest
        if any(len({one.keys[place] for one in same}) > 1 for same in by_value.values())
    ]
    along = [
        place
        for place in rest
        if place not in others and len({one.keys[place] for one in on_axis}) > 1
    ]
    by_others: dict[tuple[str, ...], list[Combination]] = {}
    for one in on_axis:
        by_others.setdefault(tuple(one.keys[place] for place in others), []).append(one)

    many, averaged = len(values) > MOST_VALUES, len(by_others) > MOST_LINES
    lines: list[tuple[tuple[Any, ...], list[tuple[Any, Mean]]]] = []
    if averaged and not many:
        lines = [((), [(c[0].values[axis], _average(c, figure)) for c in by_value.values()])]
    elif not many:
        for same in by_others.values():
            told = tuple(same[0].values[place] for place in others)
            lines.append((told, [(c.values[axis], c.mean(figure)) for c in same]))
    cloud: list[tuple[Any, float]] = []
    if many or averaged:
        every = -(-len(on_axis) // MOST_DOTS)
        told = [(c.values[axis], c.found(figure).values()) for c in on_axis[::every]]
        cloud = [(x, sum(value for _, value in of) / len(of)) for x, of in told]
    return Trend(
        values=values,
        lines=lines,
        cloud=cloud,
        averaged=averaged and not many,
        others=others,
        along=along,
        joined=bool(others) or not along or any(len(one.trials) > 1 for one in on_axis),
        left_out=len(having) - len(on_axis),
        had=len(on_axis),
    )


def _average(found: Sequence[Combination], figure: str) -> Mean:
    """Average over combinations, then over the seeds that all of them have.

    What the combinations differ by is no uncertainty: only the seeds' averages tell that.
    """
    told = [one.found(figure) for one in found]
    seeds = set(told[0]).intersection(*told[1:])
    if seeds:
        return mean_of(sum(one[seed][1] for one in told) / len(told) for seed in sorted(seeds))
    means = [sum(value for _, value in one.values()) / len(one) for one in told]
    return Mean(sum(means) / len(means), None, 0)
