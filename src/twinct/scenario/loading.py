"""Loading of scenarios, and their JSON Schema."""

from __future__ import annotations

import json
import logging
import re
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from twinct.core.arguments import kinds_checked
from twinct.core.errors import InputError, ScenarioError
from twinct.core.files.boundary import ABSENT, no_file
from twinct.core.files.plain_yaml import written
from twinct.core.files.writing import write_text
from twinct.core.foreign_text import shortened
from twinct.core.settings import Section
from twinct.scenario.messages import place, refusal
from twinct.scenario.objects import with_paths
from twinct.scenario.reading import Draft, Overrides, ScenarioText, Source, drafted, key_of, varied
from twinct.scenario.scenario import Scenario

log = logging.getLogger(__name__)

ModelT = TypeVar("ModelT", bound=Section)


@kinds_checked
def load_scenario(
    source: str | Path | Mapping[str, Any] | ScenarioText,
    overrides: Overrides = (),
    *,
    resolved: bool = False,
) -> Scenario:
    """Read, extend, override and validate a scenario.

    Args:
        source: YAML file, whose key ``extends`` names the file it builds on, relative to itself;
            the name of a built-in scenario, as ``extends`` may be, too; a mapping, in which
            files are relative to the working folder; or the text of a file (``ScenarioText``).
        overrides: values by dotted key, such as ``{"trajectory.views": 12}``; or ``KEY=VALUE``
            texts, as ``--set`` takes them.
        resolved: True if twinct wrote the file, with all defaults: then no key is reported that
            another algorithm leaves out.

    Raises:
        ScenarioError: with one sentence for each problem, naming key, value and origin.
    """
    draft = drafted(source, overrides)
    for sentence in () if resolved else draft.left_out:
        _warn_once(sentence)
    return _checked(draft)


def as_scenario(scenario: Scenario | str | Path, keys: Mapping[str, Any] | None = None) -> Scenario:
    """Return a scenario, or that of a file, with other values of some keys.

    Raises:
        ScenarioError: the file, a key or its value is wrong.
    """
    if isinstance(scenario, Scenario):
        return scenario.with_(keys) if keys else scenario
    return load_scenario(scenario, keys or {})


@cache
def _warn_once(sentence: str) -> None:
    """Log a warning, once per process: a loop over scenarios would repeat it."""
    log.warning(sentence)


@dataclass(frozen=True)
class Template:
    """Scenario that is read once, and from which others are made by changing keys."""

    draft: Draft

    @classmethod
    def read(cls, source: str | Path | Mapping[str, Any], overrides: Overrides = ()) -> Template:
        """Read a scenario as ``load_scenario`` does; it may be incomplete."""
        return cls(drafted(source, overrides))

    def changed(self, changes: Mapping[str, Any], places: Mapping[str, str]) -> Template:
        """Return a template with some keys changed for good.

        Raises:
            ScenarioError: a key leads through a plain value or to a missing list index.
        """
        return Template(varied(self.draft, changes, places))

    def varied(self, changes: Mapping[str, Any], places: Mapping[str, str]) -> Scenario:
        """Return the scenario with some keys changed; messages cite ``places`` as origins.

        Raises:
            ScenarioError: as ``load_scenario`` does.
        """
        return _checked(varied(self.draft, changes, places))

    @property
    def data(self) -> Mapping[str, Any]:
        """Keys and values that the template sets, as plain data."""
        return self.draft.data


def _checked(draft: Draft) -> Scenario:
    scenario = _validate(draft)
    problems = [
        place(draft, key_of(key)) + _absent(file, why)
        for key, file in scenario.files().items()
        if (why := no_file(file, folder=True))
    ]
    if problems:
        raise ScenarioError(problems)
    return scenario


def _absent(file: Path, why: str) -> str:
    name = shortened(str(file), 300)
    return f"no file at {name}" if why == ABSENT else f"{name} {why}"


def write_scenario(
    path: Path,
    source: Source,
    overrides: Overrides = (),
    changes: Mapping[str, Any] | None = None,
) -> None:
    """Write a scenario, together with the files it extends and its overrides, as one file.

    Files in the folder of the new file are named relative to it, all others by absolute paths.

    Args:
        path: the new file.
        source: as of ``load_scenario``.
        overrides: as of ``load_scenario``.
        changes: further values by dotted key, as plain data with absolute paths.
    """
    draft, folder = drafted(source, overrides), path.resolve().parent
    if changes:
        draft = varied(draft, changes, dict.fromkeys(changes, str(path)))

    def named(file: Path) -> Path:
        return Path(file.name) if file.parent == folder else file

    write_text(path, written(with_paths(draft.data, named)))


@contextmanager
def named_places(source: Source, overrides: Overrides = ()) -> Generator[None, None, None]:
    """Add the origin of a key, file and line or override, to problems that begin with the key.

    Problems that appear only when a scenario is used, such as an unknown material, state the key
    alone. The arguments are those of ``load_scenario``.
    """
    try:
        yield
    except InputError as error:
        if any(_KEY.match(problem) for problem in error.problems):
            draft = drafted(source, overrides)
            error.problems = tuple(_with_place(draft, problem) for problem in error.problems)
        raise


_KEY = re.compile(r"([a-z_]+(?:\.[a-z_0-9]+)+): ")


def _with_place(draft: Draft, problem: str) -> str:
    match = _KEY.match(problem)
    origin = draft.origin(key_of(match[1])) if match else ""
    return f"{origin}: {problem}" if origin else problem


def parse_scenario(data: Mapping[str, Any]) -> Scenario:
    """Validate a scenario given as plain data, such as a scan store's; its files may be missing.

    Raises:
        ScenarioError: with one sentence for each problem.
    """
    return _validate(drafted(data, extends=False))


def scenario_schema() -> dict[str, Any]:
    """Return the JSON Schema of the scenario file, for editors."""
    schema = Scenario.model_json_schema()
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["title"] = "twinct scenario"
    schema["properties"]["extends"] = {
        "type": "string",
        "description": "Scenario file that this one extends, relative to this one; or the name of "
        "a built-in scenario, such as paper.",
    }
    return json.loads(json.dumps(schema), object_hook=_with_keys_left_out)


def _with_keys_left_out(part: dict[str, Any]) -> dict[str, Any]:
    """Drop required keys and discriminators: a file that extends another may leave out any key."""
    return {
        "anyOf" if key == "oneOf" else key: value
        for key, value in part.items()
        if key != "discriminator" and not (key == "required" and isinstance(value, list))
    }


def _validate(draft: Draft) -> Scenario:
    return validated(draft, Scenario)


def validated(draft: Draft, model: type[ModelT]) -> ModelT:
    """Validate a draft strictly.

    Raises:
        ScenarioError: with one sentence for each problem.
    """
    try:
        text = json.dumps(draft.data, default=str)
    except (TypeError, ValueError, RecursionError) as error:  # plain data that came from no file
        why = shortened(str(error))
        raise ScenarioError(f"a scenario must consist of plain data: {why}") from None
    try:
        # In JSON mode, strict validation still takes lists for tuples and text for paths.
        return model.model_validate_json(text, strict=True)
    except ValidationError as error:
        raise refusal(draft, error, model) from None
