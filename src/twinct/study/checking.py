"""Checks of all trials of a study before the first one starts, with their costs."""

from __future__ import annotations

import difflib
import hashlib
import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from twinct.core.errors import InputError, SpecimenError
from twinct.core.foreign_text import quoted
from twinct.core.progress import SILENT, Progress
from twinct.core.settings import FILE_KEYS
from twinct.runs import needs
from twinct.runs.pilot import measured_time
from twinct.scenario import Part, Scenario, stage_digests
from twinct.specimen.materials import material
from twinct.study.cost import Cost
from twinct.study.design import Design, Trial
from twinct.study.trial_figures import figure_names

MOST_PROBLEMS = 9
"""Number of problems after which checking stops."""


@dataclass
class Checker:
    """Checker of the trials of a design; caches costs and materials.

    With ``time``, it measures the time of each kind of trials by small scans.
    """

    design: Design
    time: bool = False
    costs: dict[str, Cost] = field(default_factory=dict[str, Cost])
    materials: dict[str, tuple[str, ...]] = field(default_factory=dict[str, tuple[str, ...]])

    def checked(self, trials: Iterable[Trial], progress: Progress = SILENT) -> list[Trial]:
        """Check trials, and return all of them with their digests and costs.

        Raises:
            InputError: one sentence for each problem, for about the first nine.
        """
        valid: list[Trial] = []
        problems: dict[str, Trial] = {}
        figures: set[str] = set()
        for trial in progressed(trials, progress):
            try:
                scenario = self.design.scenario(trial)
                self._check_materials(scenario.specimen.parts)
            except InputError as error:
                for problem in error.problems:
                    problems.setdefault(problem, trial)
                if len(problems) >= MOST_PROBLEMS:
                    break
                continue
            if not problems:
                figures.update(figure_names(scenario))
                valid.append(self._checked(trial, scenario))
        if problems:
            lines = [f"{p}; in {trial}" if trial.axes else p for p, trial in problems.items()]
            if len(problems) >= MOST_PROBLEMS:
                lines = [*lines[:MOST_PROBLEMS], "further trials were not checked"]
            raise InputError(lines)
        self._require_figures(figures)
        self._require_different(valid)
        return valid

    def _require_figures(self, figures: set[str]) -> None:
        """Check that the trials have the requested figures, and that no axis is named like one."""
        wanted = self.design.study.figures
        if self.design.study.search:
            wanted = (*wanted, self.design.study.search.figure)
        if missing := [name for name in wanted if name not in figures]:
            raise InputError(self._unknown_figure(missing[0], figures))
        if taken := [label for label in self.design.labels if label in figures]:
            raise InputError(
                f"axis {taken[0]}: a figure has this name; give the axis another 'label'"
            )

    def _require_different(self, trials: list[Trial]) -> None:
        first: dict[str, Trial] = {}
        for one in trials:
            same = first.setdefault(one.key, one)
            if same is not one and not self.design.study.search:
                place = self.design.at("axes", "repetitions")
                raise InputError(f"{place}{same} and {one} are identical: a value is listed twice")

    def _unknown_figure(self, name: str, known: set[str]) -> str:
        place = self.design.places.get("figures", "")
        hint = f"choose from {', '.join(sorted(known))}"
        if near := difflib.get_close_matches(name, known, n=3, cutoff=0.6):
            hint = f"did you mean {' or '.join(map(repr, near))}?"
        return f"{place + ': ' if place else ''}figure {quoted(name)}: no trial has it; {hint}"

    def _check_materials(self, parts: Sequence[Part]) -> None:
        """Raise if a material is unknown; look up each material once.

        Raises:
            SpecimenError: one sentence for each unknown material.
        """
        problems: list[str] = []
        for index, part in enumerate(parts):
            description = repr(part.material)
            if description not in self.materials:
                self.materials[description] = ()
                try:
                    material(part.material, origin=f"specimen.parts.{index}.material")
                except SpecimenError as error:
                    self.materials[description] = error.problems
            place = self.design.places.get(f"specimen.parts.{index}.material", "")
            problems += [f"{place}: {p}" if place else p for p in self.materials[description]]
        if problems:
            raise SpecimenError(problems)

    def one(self, trial: Trial) -> Trial:
        """Return a single trial of a search with its digests and cost.

        Raises:
            ScenarioError: the scenario is invalid.
        """
        return self._checked(trial, self.design.scenario(trial))

    def _checked(self, trial: Trial, scenario: Scenario) -> Trial:
        digests = stage_digests(scenario)
        key = trial_key(digests["volume"], trial)
        cost = self._cost(scenario, digests["surface"])
        measured = scenario.evaluation.model_dump_json() if scenario.evaluation else ""
        volume = digests["volume"] + digests["believed"] + measured
        return replace(trial, key=key, scan=digests["images"], volume=volume, cost=cost)

    def _cost(self, scenario: Scenario, surface: str) -> Cost:
        study, detector, section = self.design.study, scenario.detector, scenario.reconstruction
        views = getattr(scenario.trajectory, "views", None)
        views = views or scenario.trajectory.model_dump(mode="json")
        how = [study.link, study.threads]
        panel = [views, detector.columns, detector.rows]
        scan = [*panel, surface, scenario.cell.kind, scenario.source.motion_samples, detector.keep]
        volume = [section.algorithm, getattr(section, "iterations", 1), section.grid]
        rest = [*panel, *volume, len(section.geometries), study.keep]
        kinds = _digest([*scan, *how]), _digest([*rest, *how])
        if (both := "".join(kinds)) not in self.costs:
            if self.time:
                measured_time(scenario, study.link)
            self.costs[both] = Cost(*kinds, needs(scenario, study.link))
        return self.costs[both]


def trial_key(volume: str, trial: Trial) -> str:
    """Return the digest of a trial's volume and its changes, independent of its number."""
    changes = {  # files count by content (in the volume's digest) and name, not by folder
        key: Path(value).name if key.rpartition(".")[2] in FILE_KEYS else value
        for key, value in trial.changes.items()
    }
    text = json.dumps([volume, changes], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def progressed(trials: Iterable[Trial], progress: Progress) -> Iterator[Trial]:
    """Yield the trials, and report the progress as a stage."""
    listed = list(trials)
    with progress.stage("check of all trials", len(listed)) as step:
        for trial in listed:
            yield trial
            step()


def _digest(data: Any) -> str:
    text = json.dumps(data, sort_keys=True, default=lambda section: section.model_dump(mode="json"))
    return hashlib.sha256(text.encode()).hexdigest()[:16]
