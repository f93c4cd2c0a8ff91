"""Sections of a study file: scenario, varied keys, repetitions, and stored results."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, JsonValue, model_validator

from twinct.settings import Conflict, ConflictError, Finite, NonNegative, Positive, Section, setting


def _dotted(text: str) -> str:
    if not re.fullmatch(r"[a-z_0-9]+(\.[a-z_0-9]+)*", text):
        raise ValueError(f"{text!r} is no dotted key such as reconstruction.relaxation")
    return text


Key = Annotated[str, AfterValidator(_dotted)]
Keys = Key | Annotated[tuple[Key, ...], Field(min_length=1)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]
Count = Annotated[int, Field(ge=1)]


class Range(Section):
    """Evenly spaced numbers, both ends included."""

    first: Finite = Field(description="The first number.")
    last: Finite = Field(description="The last number.")
    number: Count = Field(description="How many.")
    scale: Literal["linear", "log"] = setting("linear", "Even steps of the numbers or their logs.")
    whole: bool = setting(False, "Round to whole numbers.")

    @model_validator(mode="after")
    def _positive(self) -> Range:
        if self.scale == "log" and min(self.first, self.last) <= 0:
            message = f"a log scale needs numbers above 0, not {self.first:g} to {self.last:g}"
            raise ConflictError(Conflict(message, ("first", "last", "scale")))
        return self


class _Draw(Section):
    number: Count = Field(description="How many are drawn.")
    seed: Seed = setting(0, "Keys the draws.")


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
    label: str | None = setting(None, "What tables call it; the key unless given.")
    values: tuple[JsonValue, ...] | None = setting(None, "A value each.", min_length=1)
    range: Range | None = setting(None, "Or numbers at even steps.")
    draw: Draw | None = setting(None, "Or numbers drawn from a distribution.")
    paired: tuple[Axis, ...] | None = setting(
        None, "Or axes that go on together: first value with first value.", min_length=2
    )
    only: dict[Key, JsonValue] = setting(
        {}, "Varied only where these keys have these values, such as an algorithm; else left alone."
    )

    @model_validator(mode="after")
    def _one_way(self) -> Axis:
        ways = [name for name in ("values", "range", "draw", "paired") if getattr(self, name)]
        if len(ways) != 1:
            found = f"{' and '.join(ways)} are there" if ways else "there is none of them"
            raise ConflictError(
                Conflict(
                    f"one of values, range, draw and paired is needed; {found}", (*ways, "key")
                )
            )
        if (self.paired is None) == (self.key is None):
            message = "an axis has a key, or pairs axes that have one each"
            raise ConflictError(Conflict(message, ("key", "paired")))
        for axis in self.paired or ():
            if axis.paired or axis.only:
                message = "axes that are paired have key and values, no 'paired' or 'only'"
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

    number: Count = Field(description="How many seeds.")
    key: Keys = setting("seed", "The key that gets them, such as uncertainty.seed.")
    first: Seed = setting(0, "The first seed.")

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys that get the seed."""
        return (self.key,) if isinstance(self.key, str) else self.key


class Dimension(Section):
    """A key that a search may set."""

    key: Keys = Field(description="Dotted key of the scenario; several get the same value.")
    label: str | None = setting(None, "What tables call it; the key unless given.")
    low: Finite | None = setting(None, "Lower end.")
    high: Finite | None = setting(None, "Upper end.")
    scale: Literal["linear", "log"] = setting("linear", "How numbers are searched.")
    whole: bool = setting(False, "Whole numbers only.")
    choices: tuple[str | bool | int | float, ...] | None = setting(
        None, "Or one of these.", min_length=1
    )

    @model_validator(mode="after")
    def _one_way(self) -> Dimension:
        numbers = self.low is not None and self.high is not None
        if numbers == (self.choices is not None) or (self.low is None) != (self.high is None):
            message = "low and high are needed, or choices"
            raise ConflictError(Conflict(message, ("low", "high", "choices")))
        if self.low is not None and self.high is not None:
            if self.low >= self.high or (self.scale == "log" and self.low <= 0):
                message = f"no {self.scale} range from {self.low:g} to {self.high:g}"
                raise ConflictError(Conflict(message, ("low", "high", "scale")))
            if self.whole and not (self.low.is_integer() and self.high.is_integer()):
                message = f"whole numbers from {self.low:g} to {self.high:g}: both must be whole"
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
    trials: Count = Field(description="Sets of values that are tried.")
    batch: Count = setting(4, "Sets that are asked for at a time.")
    seed: Seed = setting(0, "Keys what is asked.")
    keys: tuple[Dimension, ...] = Field(description="What may be set.", min_length=1)


class Study(Section):
    """Many trials of one scenario."""

    name: str = setting("study", "Names the study on its page.", min_length=1)
    description: str = setting("", "What it is for.")
    scenario: Path | dict[str, Any] = Field(
        description="Scenario file, relative to the study's; or a scenario itself."
    )
    set: dict[Key, JsonValue] = setting({}, "Keys of the scenario that are others in all trials.")
    axes: tuple[Axis, ...] = setting((), "What is varied; all are crossed.")
    repetitions: Repetitions | None = setting(None, "Each combination with so many seeds.")
    search: Search | None = setting(None, "A search, in place of axes.")
    keep: Literal["figures", "volume", "everything"] = setting(
        "figures", "Of each trial: its figures; also its volume; or a folder as of 'twinct run'."
    )
    figures: tuple[str, ...] = setting(
        ("image.rmse_rel", "image.ssim"), "Figures that the page shows.", min_length=1
    )
    link: Literal["local", "ros2"] = setting("local", "Between the two simulations of a trial.")
    threads: Count = setting(1, "That each trial may use.")
    max_trials: Count = setting(10_000, "More than so many are refused.")

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
