"""Trials that repeat a combination of values: means with confidence intervals, over each axis."""

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
"""Largest number of combinations of the other axes that a picture distinguishes."""
MOST_VALUES = 60
"""Largest number of values on an axis; with more, only a cloud of combinations is drawn."""
MOST_DOTS = 1000
"""Largest number of dots in a cloud."""


@dataclass(frozen=True, eq=False)
class StudyTrial:
    """One trial of a study, as on the study's page.

    Attributes:
        trial: number of the trial.
        axes: value on each axis, by the axis's label; None if an axis does not apply.
        seed: seed of the repetition.
        done: True if the trial has figures; otherwise it failed.
        figures: figures by dotted name; None if one is not finite.
        seconds: seconds of each stage.
        message: reason for the failure.
        kind: class of the error.
        report: path of its report, relative to the page; empty if there is none.
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


class MeanAndInterval(NamedTuple):
    """Mean over n repetitions, and half the width of its interval; None if undefined."""

    mean: float | None
    half: float | None
    n: int


def mean_of(values: Iterable[float | None]) -> MeanAndInterval:
    """Compute mean and Student's interval, mean +- t s / sqrt(n) with n - 1 degrees of freedom.

    Source: Student, The probable error of a mean, Biometrika 6 (1908). None values are ignored;
    a single value has no interval.
    """
    x = np.array([value for value in values if value is not None], dtype=np.float64)
    if not x.size:
        return MeanAndInterval(None, None, 0)
    half = None
    if x.size > 1:
        quantile = scipy.special.stdtrit(x.size - 1, 0.5 + CONFIDENCE / 2)
        half = float(quantile * x.std(ddof=1) / math.sqrt(x.size))
    return MeanAndInterval(float(x.mean()), half, x.size)


@dataclass(frozen=True, eq=False)
class Combination:
    """Trials with the same values on all axes, in the axes' order, including failed trials.

    Attributes:
        keys: texts that identify the values.
    """

    values: tuple[Any, ...]
    keys: tuple[str, ...]
    trials: tuple[StudyTrial, ...]

    def values_of(self, figure: str) -> dict[int, tuple[StudyTrial, float]]:
        """Return the trials that have a figure, and its values, by seed, or else by place."""
        having = [(one, one.figures.get(figure)) for one in self.trials if one.done]
        return {
            place if one.seed is None else one.seed: (one, value)
            for place, (one, value) in enumerate(having)
            if value is not None
        }

    def mean(self, figure: str) -> MeanAndInterval:
        """Return the mean of a figure over the repetitions."""
        return mean_of(value for _, value in self.values_of(figure).values())


def combinations(trials: Iterable[StudyTrial], labels: Sequence[str]) -> list[Combination]:
    """Group trials by their values on the axes, in the order of the first trials."""
    groups: dict[tuple[str, ...], list[StudyTrial]] = {}
    for one in sorted(trials, key=lambda one: one.trial):
        keys = tuple(json.dumps(one.axes.get(label), sort_keys=True) for label in labels)
        groups.setdefault(keys, []).append(one)
    return [
        Combination(tuple(same[0].axes.get(label) for label in labels), keys, tuple(same))
        for keys, same in groups.items()
    ]


@dataclass(frozen=True, eq=False)
class Trend:
    """Figure over an axis.

    Attributes:
        values: values on the axis: numbers by size, others in order of appearance.
        lines: points (value, mean) for each combination of the other axes' values; one line without
            such values if there are no other axes, or if they are averaged.
        cloud: (value, mean) of each single combination, or of ``MOST_DOTS`` of them evenly.
        averaged: True if there were too many combinations of the other axes, so that the line's
            points are averages.
        others: places of the other axes that vary at one value of this axis.
        along: places of the axes that vary only with this axis, so that points show their effects,
            too.
        joined: True if neighbours are ordered values, rather than separate draws of many axes.
        left_out: number of combinations to which the axis does not apply.
        had: number of combinations to which the axis applies.
    """

    values: Sequence[Any]
    lines: Sequence[tuple[tuple[Any, ...], Sequence[tuple[Any, MeanAndInterval]]]]
    cloud: Sequence[tuple[Any, float]]
    averaged: bool
    others: Sequence[int]
    along: Sequence[int]
    joined: bool
    left_out: int
    had: int

    @property
    def has_intervals(self) -> bool:
        """True if any point has an interval."""
        return any(mean.half is not None for _, line in self.lines for _, mean in line)


def numeric(values: Iterable[Any]) -> bool:
    """Return whether all values are numbers."""
    return all(isinstance(v, int | float) and not isinstance(v, bool) for v in values)


def trend(combinations: Sequence[Combination], axis: int, figure: str) -> Trend:
    """Return a figure over one axis, given by its place among all axes."""
    having = [one for one in combinations if one.values_of(figure)]
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
    lines: list[tuple[tuple[Any, ...], list[tuple[Any, MeanAndInterval]]]] = []
    if averaged and not many:
        lines = [((), [(c[0].values[axis], _average(c, figure)) for c in by_value.values()])]
    elif not many:
        for same in by_others.values():
            points = tuple(same[0].values[place] for place in others)
            lines.append((points, [(c.values[axis], c.mean(figure)) for c in same]))
    cloud: list[tuple[Any, float]] = []
    if many or averaged:
        every = -(-len(on_axis) // MOST_DOTS)
        points = [(c.values[axis], c.values_of(figure).values()) for c in on_axis[::every]]
        cloud = [(x, sum(value for _, value in of) / len(of)) for x, of in points]
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


def _average(combinations: Sequence[Combination], figure: str) -> MeanAndInterval:
    """Average over combinations, then over their common seeds.

    Differences between combinations are no uncertainty; only the averages of the seeds show it.
    """
    by_seed = [one.values_of(figure) for one in combinations]
    seeds = set(by_seed[0]).intersection(*by_seed[1:])
    if seeds:
        return mean_of(
            sum(one[seed][1] for one in by_seed) / len(by_seed) for seed in sorted(seeds)
        )
    means = [sum(value for _, value in one.values()) / len(one) for one in by_seed]
    return MeanAndInterval(sum(means) / len(means), None, 0)
