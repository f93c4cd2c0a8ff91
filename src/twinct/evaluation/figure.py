"""Figures in words: title, unit, meaning, and the direction of better values."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

Best = Literal["lower", "higher", "one", ""]
"""Better values: lower ones, higher ones, or values nearest to 1; empty if unknown."""

BADNESS: Mapping[Best, Callable[[float], float]] = {
    "lower": lambda value: value,
    "higher": lambda value: -value,
    "one": lambda value: abs(value - 1),
    "": lambda value: 0.0,
}
"""Functions that are lower for better values."""


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
    """

    key: str
    title: str
    unit: str = ""
    factor: float = 1.0
    digits: int = 3
    meaning: str = ""
    best: Best = ""

    @property
    def label(self) -> str:
        """Title and unit."""
        return f"{self.title} / {self.unit}" if self.unit else self.title

    def relative_to(self, reference: str) -> Figure:
        """Return the figure in words that name the reference material."""
        title, meaning = (text.replace("{0}", reference) for text in (self.title, self.meaning))
        return replace(self, title=title, meaning=meaning)


def percent(key: str, title: str, meaning: str, best: Best = "", digits: int = 2) -> Figure:
    """Return a relative figure that is displayed in per cent."""
    return Figure(key, title, "%", 100, digits, meaning, best)
