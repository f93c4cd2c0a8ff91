"""Sections of a study file: scenario, varied keys, repetitions, and stored results."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, JsonValue, model_validator

from twinct.core.foreign_text import quoted
from twinct.core.settings import (
    Conflict,
    ConflictError,
    Finite,
    NonNegative,
    Positive,
    Section,
    setting,
)


def _dotted(text: str) -> str:
    if not re.fullmatch(r"[a-z_0-9]+(\.[a-z_0-9]+)*", text):
        raise ValueError(f"{quoted(text)} is not a dotted key such as reconstruction.relaxation")
    return text


Key = Annotated[str, AfterValidator(_dotted)]
Keys = Key | Annotated[tuple[Key, ...], Field(min_length=1)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]
Count = Annotated[int, Field(ge=1)]


class Range(Section):
    """Evenly spaced numbers, both ends included."""

    first: Finite = Field(description="The first number.")
    last: Finite = Field(description="The last number.")
    number: Count = Field(description="Number of values.")
    scale: Literal["linear", "log"] = setting(
        "linear", "Even steps in the numbers or in their logarithms."
    )
    whole: bool = setting(False, "Round to whole numbers.")

    @model_validator(mode="after")
    def _positive(self) -> Range:
        if self.scale == "log" and min(self.first, self.last) <= 0:
            message = f"a log scale needs numbers above 0, not {self.first:g} to {self.last:g}"
            raise ConflictError(Conflict(message, ("first", "last", "scale")))
        return self


class _Draw(Section):
    number: Count = Field(description="Number of draws.")
    seed: Seed = setting(0, "Seed of the draws.")


class _Between(_Draw):
    low: Finite = Field(description="Lower end.")
    high: Finite = Field(description="Upper end.")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.low > self.high:
            message = f"nothing lies between low {self.low:g} and high {self.high:g}"
            raise ConflictError(Conflict(message, ("low", "high")))
        return self


class UniformDraw(_Between):
    """Numbers from a uniform distribution."""

    kind: Literal["uniform"] = Field(description="Drawn evenly.")


class LogUniformDraw(_Between):
    """Numbers from a log-uniform distribution."""

    kind: Literal["log_uniform"] = Field(description="Logarithms drawn evenly.")
    low: Positive = Field(description="Lower end.")
    high: Positive = Field(description="Upper end.")


class NormalDraw(_Draw):
    """Numbers from a normal distribution."""

    kind: Literal["normal"] = Field(description="Drawn normally.")
    mean: Finite = Field(description="Mean.")
    sigma: NonNegative = Field(description="Standard deviation.")


Draw = Annotated[UniformDraw | LogUniformDraw | NormalDraw, Field(discriminator="kind")]


class Axis(Section):
    """Axis of a study: a key that is varied, or several keys at once."""

    key: Keys | None = setting(None, "Dotted key of the scenario; several get the same value.")
    label: str | None = setting(None, "Name in tables; default: the key.")
    values: tuple[JsonValue, ...] | dict[str, JsonValue] | None = setting(
        None, "Values to try; or their names in tables, each with its value.", min_length=1
    )
    range: Range | None = setting(None, "Alternatively: evenly spaced numbers.")
    draw: Draw | None = setting(None, "Alternatively: numbers drawn from a distribution.")
    paired: tuple[Axis, ...] | None = setting(
        None,
        "Alternatively: axes varied together, the first value of one with the first of the other.",
        min_length=2,
    )
    only: dict[Key, JsonValue] = setting(
        {}, "Vary only where these keys have these values, such as an algorithm; else leave alone."
    )

    @model_validator(mode="after")
    def _one_way(self) -> Axis:
        ways = [name for name in ("values", "range", "draw", "paired") if getattr(self, name)]
        if len(ways) != 1:
            problem = f"{' and '.join(ways)} are given" if ways else "none is given"
            raise ConflictError(
                Conflict(
                    f"one of values, range, draw and paired is needed; {problem}", (*ways, "key")
                )
            )
        if (self.paired is None) == (self.key is None):
            message = "an axis needs either a key or paired axes with a key each"
            raise ConflictError(Conflict(message, ("key", "paired")))
        for axis in self.paired or ():
            if axis.paired or axis.only:
                message = "paired axes take a key and values, but no 'paired' or 'only'"
                raise ConflictError(Conflict(message, ("paired",)))
        return self

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys that get its values."""
        return (self.key,) if isinstance(self.key, str) else self.key or ()

    @property
    def name(self) -> str:
        """Name in tables."""
        return self.label or ", ".join(self.keys)


class Repetitions(Section):
    """Repetitions of each trial with other seeds."""

    number: Count = Field(description="Number of seeds.")
    key: Keys = setting("seed", "The key that gets the seeds, such as uncertainty.seed.")
    first: Seed = setting(0, "The first seed.")

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys that get the seed."""
        return (self.key,) if isinstance(self.key, str) else self.key


class Dimension(Section):
    """A key that a search may set."""

    key: Keys = Field(description="Dotted key of the scenario; several get the same value.")
    label: str | None = setting(None, "Name in tables; default: the key.")
    low: Finite | None = setting(None, "Lower end.")
    high: Finite | None = setting(None, "Upper end.")
    scale: Literal["linear", "log"] = setting("linear", "Scale of the search.")
    whole: bool = setting(False, "Whole numbers only.")
    choices: tuple[str | bool | int | float, ...] | None = setting(
        None, "Alternatively: one of these values.", min_length=1
    )

    @model_validator(mode="after")
    def _one_way(self) -> Dimension:
        numbers = self.low is not None and self.high is not None
        if numbers == (self.choices is not None) or (self.low is None) != (self.high is None):
            message = "either low and high, or choices, are needed"
            raise ConflictError(Conflict(message, ("low", "high", "choices")))
        if self.low is not None and self.high is not None:
            if self.low >= self.high or (self.scale == "log" and self.low <= 0):
                message = f"{self.low:g} to {self.high:g} is not a valid {self.scale} range"
                raise ConflictError(Conflict(message, ("low", "high", "scale")))
            if self.whole and not (self.low.is_integer() and self.high.is_integer()):
                message = f"whole: low {self.low:g} and high {self.high:g} must be whole numbers"
                raise ConflictError(Conflict(message, ("low", "high", "whole")))
        return self

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys that get its values."""
        return (self.key,) if isinstance(self.key, str) else self.key

    @property
    def name(self) -> str:
        """Name in tables."""
        return self.label or ", ".join(self.keys)


class Search(Section):
    """Search for the values that give the best figure, instead of listed values (Optuna's TPE)."""

    figure: str = Field(description="The figure, such as image.rmse_rel; its mean over the seeds.")
    direction: Literal["minimize", "maximize"] = setting("minimize", "Which way is better.")
    trials: Count = Field(description="Number of sets of values to try.")
    batch: Count = setting(4, "Number of sets requested at a time.")
    seed: Seed = setting(0, "Seed of the search.")
    keys: tuple[Dimension, ...] = Field(description="Keys to search.", min_length=1)


class Study(Section):
    """Many trials of one scenario."""

    name: str = setting("study", "Name of the study on its page.", min_length=1)
    description: str = setting("", "Purpose of the study.")
    scenario: Path | dict[str, Any] = Field(
        description="Scenario file, relative to the study file; the name of a built-in scenario; "
        "or an inline scenario."
    )
    set: dict[Key, JsonValue] = setting({}, "Keys of the scenario to change in all trials.")
    axes: tuple[Axis, ...] = setting((), "Keys to vary; all axes are crossed.")
    repetitions: Repetitions | None = setting(None, "Repeat each combination with other seeds.")
    search: Search | None = setting(None, "A search instead of axes.")
    keep: Literal["figures", "volume", "everything"] = setting(
        "figures",
        "Results to keep of each trial: its figures, also its volume, or a folder like that of "
        "'twinct run'.",
    )
    figures: tuple[str, ...] = setting(
        ("image.rmse_rel", "image.ssim"), "Figures to show on the page.", min_length=1
    )
    link: Literal["local", "ros2"] = setting(
        "local", "Link between the two simulations of a trial."
    )
    threads: Count = setting(1, "Threads per trial.")
    max_trials: Count = setting(10_000, "Largest number of trials; a larger study is refused.")

    @property
    def ranked_by(self) -> tuple[str, Literal["lower", "higher", ""]]:
        """Figure by which trials are ranked, and the better direction; empty: the figure's own."""
        if self.search is None:
            return self.figures[0], ""
        return self.search.figure, "lower" if self.search.direction == "minimize" else "higher"

    @model_validator(mode="after")
    def _one_way(self) -> Study:
        if self.search and self.axes:
            message = "a study has axes or a search, not both"
            raise ConflictError(Conflict(message, ("axes", "search")))
        return self
