"""Design of a study: its trials, and the keys of the scenario that each of them changes."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from twinct.core.draws import view_rng
from twinct.core.errors import InputError, ScenarioError
from twinct.core.files.boundary import ABSENT, absolute, no_file
from twinct.core.settings import FILE_KEYS
from twinct.scenario import Scenario, Template
from twinct.scenario.catalogue import same_name, scenario_file
from twinct.scenario.messages import refusal
from twinct.scenario.reading import Draft, is_list, is_mapping, key_of, read_yaml
from twinct.study.cost import NO_COST, Cost
from twinct.study.results import OWN_COLUMNS
from twinct.study.settings import Axis, NormalDraw, Study


@dataclass(frozen=True, slots=True)
class Trial:
    """One scenario of a study.

    ``Checker`` adds the digests and the cost of a valid trial.

    Attributes:
        number: number in the study's order, from 0.
        axes: value of each axis by its label; None for an axis that does not apply.
        changes: dotted keys of the scenario and their new values, in order of application.
        seed: seed of the repetition; None without repetitions.
        key: hex digest that identifies the trial, independent of its number.
        scan: digest of its scan.
        volume: digests of its volume and its believed poses, and its section ``evaluation``; trials
            with equal values have equal figures.
        cost: its kind of cost; trials of one kind take similar resources.
    """

    number: int
    axes: Mapping[str, Any]
    changes: Mapping[str, Any]
    seed: int | None = None
    key: str = ""
    scan: str = ""
    volume: str = ""
    cost: Cost = NO_COST

    def __str__(self) -> str:
        """Return its name in messages."""
        lines = [f"{label} = {value}" for label, value in self.axes.items() if value is not None]
        lines += [] if self.seed is None else [f"seed {self.seed}"]
        return f"trial {self.number}" + (f" ({', '.join(lines)})" if lines else "")


UNVARIED = Trial(0, {}, {})
"""Trial with the study's template."""


@dataclass(frozen=True, eq=False)
class Design:
    """A study with its scenario, ready to run.

    Attributes:
        study: sections of the study file.
        template: the scenario, with the study's changes to all trials.
        places: origin of each varied key, for messages.
        text: text of the file, or the plain data as JSON, which is YAML, too.
        folder: folder to which files are relative.
    """

    study: Study
    template: Template
    places: Mapping[str, str]
    text: str
    folder: Path

    @cached_property
    def choices(self) -> tuple[tuple[Trial, ...], ...]:
        """Possible values of each axis, as trials that vary nothing else."""
        return tuple(tuple(_choices(axis, self.folder)) for axis in self.study.axes)

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the axes in tables."""
        if self.study.search:
            return tuple(dimension.name for dimension in self.study.search.keys)
        return tuple(label for axis in self.study.axes for label in _labels(axis))

    @property
    def seeds(self) -> tuple[int | None, ...]:
        """Seeds of the repetitions; a single None without repetitions."""
        again = self.study.repetitions
        return tuple(range(again.first, again.first + again.number)) if again else (None,)

    def trials(self) -> Iterator[Trial]:
        """Iterate over all trials of the axes; the seed changes fastest, then the last axis."""
        return itertools.chain.from_iterable(
            self.repeated(index * len(self.seeds), one)
            for index, one in enumerate(self._crossed(UNVARIED, 0))
        )

    def repeated(self, first: int, one: Trial) -> Iterator[Trial]:
        """Yield the trials of one combination, one for each seed, numbered from ``first``."""
        again = self.study.repetitions
        for number, seed in enumerate(self.seeds, first):
            seeds = dict.fromkeys(again.keys, seed) if again else {}
            labels = dict.fromkeys(self.labels) | dict(one.axes)
            yield Trial(number, labels, {**one.changes, **seeds}, seed)

    def at(self, *sections: str) -> str:
        """Return the prefix of a message: the origin of the first section that the file has."""
        place = next((self.places[name] for name in sections if name in self.places), "")
        return place and f"{place}: "

    def scenario(self, trial: Trial) -> Scenario:
        """Return the scenario of a trial.

        Raises:
            ScenarioError: see ``load_scenario``.
        """
        return self.template.varied(trial.changes, self.places)

    def _crossed(self, before: Trial, index: int) -> Iterator[Trial]:
        if index == len(self.choices):
            yield before
            return
        axis = self.study.axes[index]
        applies = all(
            self._value(key, before) in (value if is_list(value) else [value])
            for key, value in axis.only.items()
        )
        for one in self.choices[index] if applies else (UNVARIED,):
            axes, changes = {**before.axes, **one.axes}, {**before.changes, **one.changes}
            yield from self._crossed(Trial(0, axes, changes), index + 1)

    def _value(self, key: str, so_far: Trial) -> Any:
        """Return the value of a key after the changes so far, or else its default."""
        for setter, value in reversed([*so_far.changes.items()]):
            if setter == key:
                return value
            if key.startswith(f"{setter}."):  # a whole section
                return _at(value, key.removeprefix(f"{setter}."))
        return _at(self.defaults, key)

    @cached_property
    def defaults(self) -> Any:
        """All keys of the scenario before variation; without defaults if it is incomplete."""
        try:
            return self.template.varied({}, {}).model_dump(mode="json")
        except ScenarioError:  # incomplete without the axes
            return self.template.data


def load_study(source: str | Path | Mapping[str, Any]) -> Design:
    """Read and validate a study; ``Checker`` checks its trials.

    Args:
        source: YAML file, or plain data, whose files are relative to the working folder.

    Raises:
        InputError: one sentence for each problem, with key, value and origin.
    """
    if isinstance(source, Mapping):
        draft, folder = Draft(dict(source)), Path.cwd()
        text = json.dumps(draft.data, indent=1, default=str)
    else:
        path = Path(source).expanduser()
        draft, folder = read_yaml(path, "study"), path.absolute().parent
        text = path.read_text(encoding="utf-8")
    inline = draft.data.get("scenario")
    if isinstance(inline, (str, Path)):
        at = draft.origin(("scenario",))
        at = f"{at and at + ': '}scenario: "
        draft.data["scenario"] = _scenario(folder, str(inline), at)
    elif is_mapping(inline) and isinstance(inline.get("extends"), (str, Path)):
        at = draft.origin(("scenario", "extends"))
        at = f"{at and at + ': '}scenario.extends: "
        base = _scenario(folder, str(inline["extends"]), at)
        draft.data["scenario"] = inline | {"extends": base}
    try:
        study = Study.model_validate_json(json.dumps(draft.data, default=str), strict=True)
    except ValidationError as error:
        raise refusal(draft, error, Study) from None
    fixed = {key: _absolute(key, value, folder) for key, value in study.set.items()}
    where = draft.origin(("set",))
    places = {key: draft.origin(("set", key)) or f"{where}set {key}" for key in fixed}
    read = _template(study, draft).changed(fixed, places)
    design = Design(study, read, _places(study, draft), text, folder)
    if problems := list(_design_problems(design, draft)):
        raise InputError(problems)
    return design


def _template(study: Study, draft: Draft) -> Template:
    """Read the study's scenario; an inline scenario keeps the line numbers of its keys."""
    if isinstance(study.scenario, dict):
        read = Template.read(study.scenario)
        lines = {key[1:]: at for key, at in draft.origins.items() if key[:1] == ("scenario",)}
        read.draft.record(lines)
        return read
    if why := no_file(study.scenario):
        place = draft.origin(("scenario",))
        problem = f"no file at {study.scenario}" if why == ABSENT else f"{study.scenario} {why}"
        raise InputError(f"{place and place + ': '}scenario: {problem}{same_name(study.scenario)}")
    return Template.read(study.scenario)


def _places(study: Study, draft: Draft) -> dict[str, str]:
    sections = ("figures", "axes", "search", "repetitions", "max_trials")
    places = {
        key: place for key in sections if key in draft.data and (place := draft.origin((key,)))
    }
    for index, axis in enumerate(study.axes):
        for inner, part in enumerate(axis.paired or (axis,)):
            where = ("axes", index, "paired", inner) if axis.paired else ("axes", index)
            place = draft.origin((*where, "key"))
            for key in part.keys:
                places[key] = f"{place}: axis {part.name}" if place else f"axis {part.name}"
    for name, keys in (
        ("repetitions", study.repetitions.keys if study.repetitions else ()),
        *((f"search {d.name}", d.keys) for d in (study.search.keys if study.search else ())),
    ):
        place = draft.origin((name.partition(" ")[0],))
        places |= dict.fromkeys(keys, f"{place}: {name}" if place else name)
    return places


def _design_problems(design: Design, draft: Draft) -> Iterator[str]:
    study = design.study
    parts = [part for axis in study.axes for part in axis.paired or (axis,)]
    numbers = {part.name: span.number for part in parts if (span := part.range or part.draw)}
    numbers |= {"repetitions": study.repetitions.number} if study.repetitions else {}
    if many := [f"{name} has {n}" for name, n in numbers.items() if n > study.max_trials]:
        place = design.at("max_trials", "axes", "repetitions")
        yield f"{place}more than {study.max_trials} trials (max_trials): {', '.join(many)}"
        return  # the checks below would generate all values
    for index, axis in enumerate(study.axes):
        numbers = {part.name: len(list(_values(part))) for part in axis.paired or ()}
        if len(set(numbers.values())) > 1:
            text = ", ".join(f"{name} has {number}" for name, number in numbers.items())
            place = draft.origin(("axes", index, "paired"))
            yield f"{place + ': ' if place else ''}axes.{index}.paired: {text}; they must be equal"
    for label in dict.fromkeys(design.labels):
        other = "another axis" if design.labels.count(label) > 1 else "a column of the results"
        own = label in OWN_COLUMNS or label.startswith("seconds.")
        if own or design.labels.count(label) > 1:
            named = [*parts, *(study.search.keys if study.search else ())]
            place = design.places[next(p for p in reversed(named) if p.name == label).keys[0]]
            yield f"{place}: {other} has this name; give it another 'label'"
    repeated = study.repetitions.keys if study.repetitions else ()
    dimensions = study.search.keys if study.search else ()
    keys = [key for part in parts for key in part.keys]
    keys += [*repeated, *(key for dimension in dimensions for key in dimension.keys)]
    for key in dict.fromkeys(key for key in keys if keys.count(key) > 1):
        yield f"{design.places[key]}: {key} is varied twice"
    earlier: set[str] = set()
    for axis in study.axes:
        for key in axis.only:
            if key not in earlier and _at(design.defaults, key) is None:
                place = f"{design.places[axis.keys[0]]}: " if axis.keys else ""
                yield f"{place}only: {key} is not a key of the scenario or an earlier axis"
        earlier |= {key for part in axis.paired or (axis,) for key in part.keys}


def _labels(axis: Axis) -> tuple[str, ...]:
    return tuple(part.name for part in axis.paired or (axis,))


def _choices(axis: Axis, folder: Path) -> Iterator[Trial]:
    parts = axis.paired or (axis,)
    for values in zip(*(_named_values(part) for part in parts), strict=True):
        pairs = list(zip(parts, values, strict=True))
        yield Trial(
            0,
            {part.name: name for part, (name, _) in pairs},
            {key: _absolute(key, value, folder) for part, (_, value) in pairs for key in part.keys},
        )


def _named_values(axis: Axis) -> Iterable[tuple[Any, Any]]:
    """Return the values of an axis, each behind what tables call it."""
    if isinstance(axis.values, dict):
        return axis.values.items()
    return ((_table_value(value), value) for value in _values(axis))


def _values(axis: Axis) -> Iterable[Any]:
    if axis.values is not None:
        return axis.values.values() if isinstance(axis.values, dict) else axis.values
    if span := axis.range:
        if span.scale == "log":
            numbers = np.geomspace(span.first, span.last, span.number)
        else:
            numbers = np.linspace(span.first, span.last, span.number)
        # Twelve digits remove rounding errors of the step, such as 0.30000000000000004.
        numbers_rounded = [float(f"{number:.12g}") for number in numbers]
        return dict.fromkeys(round(x) for x in numbers_rounded) if span.whole else numbers_rounded
    draw = axis.draw
    assert draw is not None
    rng = view_rng(draw.seed, f"axis {', '.join(axis.keys)}", 0)
    if isinstance(draw, NormalDraw):
        return rng.normal(draw.mean, draw.sigma, draw.number).tolist()
    if draw.kind == "uniform":
        return rng.uniform(draw.low, draw.high, draw.number).tolist()
    return np.exp(rng.uniform(math.log(draw.low), math.log(draw.high), draw.number)).tolist()


def _table_value(value: Any) -> Any:
    """Return a value as a table holds it: lists and sections as JSON, others unchanged."""
    return json.dumps(value) if isinstance(value, (list, dict)) else value


def _scenario(folder: Path, name: str, at: str) -> str:
    """Return the absolute path of a scenario file, or of a built-in scenario by its name."""
    _named(folder, name)
    return str(absolute(Path(), str(scenario_file(Path(name).expanduser(), folder, at))))


def _named(folder: Path, name: str) -> str:
    try:
        return str(absolute(folder, name))
    except ValueError as error:
        raise InputError(f"{folder}: {error}") from None


def _absolute(key: str, value: Any, folder: Path) -> Any:
    """Return a value with its file names made absolute, relative to the study's folder."""
    if is_mapping(value):
        return {name: _absolute(name, inner, folder) for name, inner in value.items()}
    if is_list(value):
        return [_absolute("", inner, folder) for inner in value]
    if key.rpartition(".")[2] in FILE_KEYS and isinstance(value, str):
        return _named(folder, value)
    return value


def _at(data: Any, dotted: str) -> Any:
    for step in key_of(dotted):
        try:
            data = data[step]
        except (KeyError, IndexError, TypeError):
            return None
    return data
