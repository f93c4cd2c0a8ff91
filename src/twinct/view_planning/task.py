"""Task of view planning: a region, the objectives, and the number of views.

Objectives, built in or from extensions, bring their own keys.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import cache
from typing import Any

from pydantic import Field
from pydantic.fields import FieldInfo

from twinct.core.extensions import Registry
from twinct.core.foreign_text import quoted
from twinct.core.settings import (
    Conflict,
    Extensible,
    Finite,
    NonNegative,
    Section,
    Vector,
    complete,
    setting,
)
from twinct.view_planning.objectives import LessIsBetter, MoreIsBetter, Objective
from twinct.view_planning.objectives.objective import ObjectiveSettings
from twinct.view_planning.objectives.registry import objectives


class TryingGoal(ObjectiveSettings):
    """Error in the region of a volume made from images of each path: less is better."""


class ExposureSharing(Section):
    """Distribution of the mAs among the chosen views for the best detectability, at a fixed sum."""

    least_rel: float = setting(
        0.25, "Smallest mAs of a view, relative to the source's mAs.", unit="1", gt=0, le=1
    )
    most_rel: float = setting(
        4.0, "Largest mAs of a view, relative to the source's mAs.", unit="1", ge=1, le=1000
    )


class FamilyParameter(Section):
    """Numeric key of the scenario's trajectory that is optimised."""

    key: str = Field(description="Key in `trajectory`, such as tilt_deg.")
    low: Finite = Field(description="Lowest value.")
    high: Finite = Field(description="Highest value.")


class FamilySearch(Section):
    """Best path of the scenario's kind of trajectory, found by CMA-ES, instead of free views."""

    parameters: tuple[FamilyParameter, ...] = Field(min_length=2, description="Keys to optimise.")
    generations: int = setting(15, "Largest number of generations of the search.", ge=1, le=1000)
    population: int = setting(8, "Number of paths in each generation.", ge=4, le=1000)


class ViewTask(Extensible):
    """Goals for which `twinct plan` chooses views; a run does not read them."""

    position_mm: Vector = setting(
        (0.0, 0.0, 0.0), "Centre of the region, a ball, in the specimen's frame."
    )
    radius_mm: NonNegative = setting(20.0, "Radius of the region; 0: a point.")
    views: int = Field(ge=1, le=2000, description="Number of views to choose.")
    candidates: int = setting(
        400,
        "Number of candidate views, spread over the sphere at the trajectory's distances. Views "
        "are chosen from those that the arms can reach.",
        ge=2,
        le=20_000,
    )
    rounds: int = setting(5, "Rounds in which each view may be exchanged.", ge=0, le=100)
    trying: TryingGoal | None = setting(
        None,
        "Favour a small error in the region. Each path of a family is tried: its images, simulated "
        "with a gantry, are reconstructed as the scenario states.",
    )
    exposure: ExposureSharing | None = setting(
        None, "Give each view its own mAs; null: all views have the source's mAs."
    )
    family: FamilySearch | None = setting(
        None, "Choose the views of the best path of a family; null: choose views freely."
    )

    @classmethod
    def extension_keys(cls) -> Mapping[str, tuple[Any, FieldInfo]]:
        """Return a key for each objective."""
        return {
            name: (one.settings | None, setting(None, one.description))
            for name, one in usable_objectives().items()
        }

    @classmethod
    def own_last_keys(cls) -> Collection[str]:
        """Return the keys behind the objectives."""
        return _LAST

    @property
    def goals(self) -> dict[str, tuple[Objective[Any], Any]]:
        """Objectives of this task and their settings, by name."""
        every = ((one, getattr(self, name)) for name, one in usable_objectives().items())
        return {one.name: (one, section) for one, section in every if section is not None}

    def label(self, name: str) -> str:
        """Return the name of a figure of a plan with its unit, for tables."""
        objective, section = self.goals.get(name, (None, None))
        unit = "1" if objective is None else objective.unit(section)
        return name if unit == "1" else f"{name}, {unit}"

    def unknown_parts(self, parts: Sequence[str]) -> list[Conflict]:
        """Return the conflicts of objectives with the names of the specimen's parts."""
        return [one for goal, own in self.goals.values() for one in goal.conflicts(own, parts)]

    def conflicts(self, parts: Sequence[str]) -> list[Conflict]:
        """Return conflicts: no goal, more views than candidates, or unknown parts."""
        contradictions: list[Conflict] = []
        if not (self.trying or any(one.more_is_better for one, _ in self.goals.values())):
            gains, costs = (
                [name for name, one in usable_objectives().items() if one.more_is_better is more]
                for more in (True, False)
            )
            contradictions.append(
                Conflict(
                    f"task: {_listed(gains, 'or')} is required: {_listed(costs, 'and')} alone "
                    "would choose the same view again and again",
                    ("task",),
                )
            )
        if self.trying and not self.family:
            contradictions.append(
                Conflict(
                    "task.trying: this goal needs task.family, because it tries whole paths, "
                    "not single views; twinct plan --try tries the chosen views",
                    ("task.trying", "task.family"),
                )
            )
        if self.views > self.candidates:
            contradictions.append(
                Conflict(
                    f"task.views ({self.views}) must be at most task.candidates "
                    f"({self.candidates})",
                    ("task.views", "task.candidates"),
                )
            )
        if self.exposure and "detectability" not in self.goals:
            contradictions.append(
                Conflict(
                    "task.exposure: the mAs are distributed for the best detectability: give "
                    "task.detectability",
                    ("task.exposure", "task.detectability"),
                )
            )
        if self.exposure and self.family:
            contradictions.append(
                Conflict(
                    "task.exposure: a file of views can give each view its own mAs, a path of "
                    "task.family cannot; leave out one of the two",
                    ("task.exposure", "task.family"),
                )
            )
        family = self.family.parameters if self.family else ()
        for i, one in enumerate(family):
            key = f"task.family.parameters.{i}"
            if one.low >= one.high:
                message = f"{key}: low ({one.low:g}) must be below high ({one.high:g})"
                contradictions.append(Conflict(message, (f"{key}.low", f"{key}.high")))
            if one.key in [other.key for other in family[:i]]:
                message = f"{key}.key: {quoted(one.key)} is listed twice"
                contradictions.append(Conflict(message, (f"{key}.key",)))
        return contradictions + self.unknown_parts(parts)


_LAST = ("trying", "exposure", "family")
_OWN = frozenset(ViewTask.model_fields)
"""Keys that no objective may take."""


@cache
def usable_objectives() -> Registry[Objective[Any]]:
    """Return the objectives whose keys can stand in a task."""
    known = objectives()
    known.keep(_fits, "the objective {name}")
    return known


def _fits(objective: Objective[Any]) -> None:
    if objective.name in _OWN or hasattr(ViewTask, objective.name):
        raise ValueError("the section task has another key of this name")
    if not issubclass(objective.settings, (MoreIsBetter, LessIsBetter)):
        raise TypeError("its settings are neither MoreIsBetter nor LessIsBetter")
    complete(objective.settings)


def _listed(names: list[str], word: str) -> str:
    return f" {word} ".join(filter(None, (", ".join(names[:-1]), names[-1])))
