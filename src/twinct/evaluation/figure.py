"""Figures in words: title, unit, meaning, and the direction of better values."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

Best = Literal["lower", "higher", "one", ""]
"""Better values: lower ones, higher ones, or values nearest to 1; empty if unknown."""

BADNESS: Mapping[Best, Callable[[float], float]] = {
    "lower": lambda value: value,
    "higher": lambda value: -value,
    "one": lambda value: abs(value - 1),
    "": lambda value: 0.0,
}
"""Functions that are lower for better values."""


WithoutSignal = Literal["null", "worse", "any", ""]
"""Score of an empty or constant volume: no value; one worse than that of any decent reconstruction;
one that ranks nothing, as no value is better or all volumes have the same; empty if unknown."""

Degradation = Literal["noise", "blur", "smoothing", "shift", "contrast"]
"""Ways in which a volume gets worse than the truth: noise; blur; a noisy volume, whose detail is
lost by blur or a median filter while its noise falls; a shift; less contrast."""

REFERENCE = "the reference material"
"""Words for the material that figures are relative to, if its name is unknown or differs."""

LEAST_SIGNAL = 0.5
"""Share of the truth's contrast at which a volume is as near to a constant as to the truth.

A volume v = a t + b + e, with t the truth and e noise, is a (t - mean t) + e off the nearest
constant and (1 - a) (t - mean t) + e off the truth with its own mean. Of the two, the truth is the
likelier explanation, with normal noise of any size, if (1 - a)^2 < a^2, hence if a > 1/2.
"""

SURE = 1.645
"""Standard errors by which the signal must exceed this share: a one-sided test at 5 %."""


@dataclass(frozen=True)
class Figure:
    """Scalar figure and its display: the value times a factor, in a unit, with some digits.

    Attributes:
        key: name of the figure, dotted if figures are nested.
        title: its name on pages; {0} stands for the material that figures are relative to.
        unit: unit of the displayed value.
        factor: displayed value over stored value.
        digits: digits after the point.
        meaning: a few words; {0} as in the title.
        best: direction of better values.
        good: a good value in a few words; {0} as in the title.
        without_signal: score of an empty or constant volume.
        blind_to: degradations that the figure does not see, or rewards; None: unknown. They say
            nothing about a figure without a direction of better values, which ranks no volumes.
        beside: keys of the figures beside which alone it is shown, as it rewards smoothing; of its
            own entry, or after a slash of the image.
    """

    key: str
    title: str
    unit: str = ""
    factor: float = 1.0
    digits: int = 3
    meaning: str = ""
    best: Best = ""
    good: str = ""
    without_signal: WithoutSignal = ""
    blind_to: tuple[Degradation, ...] | None = None
    beside: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        """Title and unit."""
        return f"{self.title} / {self.unit}" if self.unit else self.title

    def relative_to(self, reference: str = REFERENCE) -> Figure:
        """Return the figure in words that name the reference material."""
        words = {name: getattr(self, name) for name in ("title", "meaning", "good")}
        return replace(
            self, **{name: text.replace("{0}", reference) for name, text in words.items()}
        )


def percent(
    key: str,
    title: str,
    meaning: str,
    best: Best = "",
    digits: int = 2,
    *,
    good: str = "",
    without_signal: WithoutSignal = "",
    blind_to: tuple[Degradation, ...] | None = None,
    beside: tuple[str, ...] = (),
) -> Figure:
    """Return a relative figure that is displayed in per cent."""
    words = meaning, best, good, without_signal
    return Figure(key, title, "%", 100, digits, *words, blind_to, beside)


def has_signal(signal_rel: float, error_rel: float = 0.0) -> bool:
    """Return True if a volume is surely nearer to the truth than to a constant.

    Args:
        signal_rel: contrast relative to the truth's; NaN if the truth itself is constant.
        error_rel: its standard error.
    """
    return not signal_rel - SURE * error_rel < LEAST_SIGNAL


def null_without_signal(data: Mapping[str, Any], figures: Iterable[Figure]) -> dict[str, Any]:
    """Return figures of a volume without signal, NaN where it would be rewarded for that."""
    result = dict(data)
    for one in figures:
        if one.without_signal == "null":
            _set_nan(result, one.key.split("."))
    return result


def _set_nan(data: dict[str, Any], path: list[str]) -> None:
    first, *others = path
    if first in data:
        data[first] = dict(data[first]) if others else math.nan
        if others:
            _set_nan(data[first], others)
