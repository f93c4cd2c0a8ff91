"""From YAML files and overrides to a valid scenario, or to one clear message for each problem."""

from __future__ import annotations

import difflib
import json
import re
import typing
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ValidationError

from twinct.errors import InputError, ScenarioError
from twinct.scenario.scenario import Scenario
from twinct.settings import Conflict, ConflictError

Key = tuple[str | int, ...]

DEEPEST = 20
"""Levels that a scenario may be nested; its own sections need six."""


class _Loader(yaml.SafeLoader):
    """YAML as scientists write it: 1e-3 is a number too, which YAML 1.1 takes for text."""


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]+$"),
    list("-+.0123456789"),
)


@dataclass
class _Draft:
    """Merged raw data, and for each key the place that set it, in the order of setting.

    A section counts as set by the last file or override that set one of its keys: what is wrong
    with a section as a whole became so there.
    """

    data: dict[str, Any] = field(default_factory=dict)
    origins: dict[Key, str] = field(default_factory=dict)

    def origin(self, key: Key) -> str:
        """The place that set a key, or the nearest key around it."""
        while key and key not in self.origins:
            key = key[:-1]
        return self.origins.get(key, "")

    def record(self, places: Mapping[Key, str]) -> None:
        """Note who set what, after all that was set before."""
        for key, place in places.items():
            self.origins.pop(key, None)
            self.origins[key] = place

    def last_origin(self, keys: Iterable[Key]) -> str:
        """The place that set the last of some keys; of the section around them if it set none."""
        keys = list(keys)
        order = {key: rank for rank, key in enumerate(self.origins)}
        return self.origin(max(keys, key=lambda key: order.get(key, -1)))


def load_scenario(path: str | Path, overrides: Iterable[str] = ()) -> Scenario:
    """Read, extend, override and validate a scenario.

    Args:
        path: YAML file; its key ``extends`` names the file it builds on, relative to itself.
        overrides: ``KEY=VALUE`` with a dotted key and a YAML value, as ``--set`` takes them.

    Raises:
        ScenarioError: with one sentence for each problem, naming key, value and origin.
    """
    draft = _draft(path, overrides)
    scenario = _validate(draft)
    missing = [
        f"{_place(draft, _key(key))}no file at {file}"
        for key, file in scenario.files().items()
        if not file.exists()
    ]
    if missing:
        raise ScenarioError(missing)
    return scenario


@contextmanager
def named_places(path: str | Path, overrides: Iterable[str] = ()) -> Iterator[None]:
    """Let problems that begin with a key say which file and line, or override, set it.

    What is found out only when a scenario is worked with, such as a material that nobody knows,
    knows the key alone.

    Args:
        path: as for ``load_scenario``.
        overrides: as for ``load_scenario``.
    """
    try:
        yield
    except InputError as error:
        if any(_KEY.match(problem) for problem in error.problems):
            draft = _draft(path, overrides)
            error.problems = tuple(_with_place(draft, problem) for problem in error.problems)
        raise


_KEY = re.compile(r"([a-z_]+(?:\.[a-z_0-9]+)+): ")


def _with_place(draft: _Draft, problem: str) -> str:
    found = _KEY.match(problem)
    origin = draft.origin(_key(found[1])) if found else ""
    return f"{origin}: {problem}" if origin else problem


def _key(dotted: str) -> Key:
    return tuple(int(step) if step.isdigit() else step for step in dotted.split("."))


def _draft(path: str | Path, overrides: Iterable[str]) -> _Draft:
    draft = _read(Path(path), ())
    for override in overrides:
        _apply_override(draft, override)
    return draft


def parse_scenario(data: Mapping[str, Any]) -> Scenario:
    """Validate a scenario given as plain data, such as from a notebook or a scan store.

    Raises:
        ScenarioError: with one sentence for each problem.
    """
    return _validate(_Draft(dict(data)))


def scenario_schema() -> dict[str, Any]:
    """JSON Schema of the scenario file, for editors."""
    schema = Scenario.model_json_schema()
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["title"] = "twinct scenario"
    schema["properties"]["extends"] = {
        "type": "string",
        "description": "Scenario file this one builds on, relative to it.",
    }
    schema.pop("required", None)  # a file that extends another may leave out any key
    return schema


def _read(path: Path, chain: tuple[Path, ...]) -> _Draft:
    path = path.expanduser()
    if path.resolve() in chain:
        raise ScenarioError(f"{path}: extends itself: " + " -> ".join(p.name for p in chain))
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8 text"
        raise ScenarioError(f"{path}: cannot read the scenario: {reason}") from None
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f":{mark.line + 1}" if mark else ""
        problem = getattr(error, "problem", None) or "not valid YAML"
        raise ScenarioError(f"{path}{line}: not valid YAML: {problem}") from None
    except RecursionError:
        raise ScenarioError(_too_deep(path)) from None
    if node is None:
        raise ScenarioError(f"{path}: the scenario is empty")
    if not isinstance(node, yaml.MappingNode):
        raise ScenarioError(f"{path}: a scenario is a mapping of keys to values")
    own = _Draft()
    own.data = _construct(loader, node, (), path, own.origins)
    parent = own.data.pop("extends", None)
    if parent is None:
        return own
    if not isinstance(parent, str):
        raise ScenarioError(f"{own.origin(('extends',))}: extends: {parent!r} is not a file name")
    base_path = path.parent / parent
    if not base_path.is_file():
        raise ScenarioError(f"{own.origin(('extends',))}: extends: no file at {base_path}")
    base = _read(base_path, (*chain, path.resolve()))
    _merge(base, own.data, own.origins, ())
    return base


def _construct(
    loader: yaml.SafeLoader, node: yaml.Node, key: Key, path: Path, origins: dict[Key, str]
) -> Any:
    """Plain data of a node; notes the line of each key and makes each ``path`` absolute."""
    origins[key] = place = f"{path}:{node.start_mark.line + 1}"
    if len(key) > DEEPEST:
        raise ScenarioError(_too_deep(place))
    if isinstance(node, yaml.MappingNode):
        data: dict[Any, Any] = {}
        for key_node, value_node in node.value:
            name = loader.construct_object(key_node, deep=True)
            if name in data:
                line = key_node.start_mark.line + 1
                raise ScenarioError(f"{path}:{line}: the key {name!r} stands twice")
            data[name] = _construct(loader, value_node, (*key, name), path, origins)
            if name == "path" and isinstance(data[name], str):
                data[name] = str((path.parent / Path(data[name]).expanduser()).resolve())
        return data
    if isinstance(node, yaml.SequenceNode):
        return [
            _construct(loader, item, (*key, i), path, origins) for i, item in enumerate(node.value)
        ]
    return loader.construct_object(node, deep=True)


def _too_deep(place: object) -> str:
    return f"{place}: nested too deep: a scenario has at most {DEEPEST} levels"


def _merge(base: _Draft, data: dict[Any, Any], origins: dict[Key, str], key: Key) -> None:
    """Lay data over the draft: mappings merge, all else replaces, a new ``kind`` starts afresh."""
    here: Any = base.data
    for step in key:
        here = here[step]
    for name, value in data.items():
        inner = (*key, name)
        old = here.get(name)
        if isinstance(old, dict) and isinstance(value, dict):
            kind = old.get("kind")
            if value.get("kind", kind) == kind:
                _merge(base, value, origins, inner)
                base.record({inner: origins[inner]})
                continue
        here[name] = value
        stale = [k for k in base.origins if k[: len(inner)] == inner]
        for k in stale:
            del base.origins[k]
        base.record({k: v for k, v in origins.items() if k[: len(inner)] == inner})


def _apply_override(draft: _Draft, override: str) -> None:
    key_text, equals, value_text = override.partition("=")
    place = f"--set {override}"
    steps = key_text.strip().split(".")
    if not equals or not all(step.strip() for step in steps):
        raise ScenarioError(f"{place}: expected KEY=VALUE, such as detector.columns=320")
    try:
        value = yaml.load(value_text, _Loader)  # noqa: S506 - a SafeLoader
    except yaml.YAMLError:
        raise ScenarioError(f"{place}: {value_text!r} is not a YAML value") from None
    except RecursionError:
        raise ScenarioError(_too_deep(f"--set {key_text}")) from None
    value = _absolute_paths({steps[-1]: value})[steps[-1]]
    key = _key(key_text.strip())
    here: Any = draft.data
    for depth, step in enumerate(steps):
        last = depth == len(steps) - 1
        if isinstance(here, list):
            if not step.isdigit() or int(step) >= len(here):
                raise ScenarioError(
                    f"{place}: {'.'.join(steps[:depth])} is a list of {len(here)}: "
                    f"{step!r} is not one of its indices"
                )
            index: Any = int(step)
        elif isinstance(here, dict):
            index = step
        else:
            raise ScenarioError(f"{place}: {'.'.join(steps[:depth])} is a value, it has no keys")
        if last:
            if isinstance(here, dict) and step == "kind" and here.get("kind", value) != value:
                _start_afresh(draft, here, key[:-1])
            here[index] = value
        elif isinstance(here, dict):
            here = here.setdefault(index, {})
        else:
            here = here[index]
    draft.origins = {k: v for k, v in draft.origins.items() if k[: len(key)] != key}
    draft.record({key[:depth]: place for depth in range(1, len(key) + 1)})


def _start_afresh(draft: _Draft, section: dict[str, Any], key: Key) -> None:
    """Empty a section that gets another kind, but for what other overrides have set."""
    for name in list(section):
        if not draft.origin((*key, name)).startswith("--set "):
            del section[name]
            gone = (*key, name)
            draft.origins = {k: v for k, v in draft.origins.items() if k[: len(gone)] != gone}


def _absolute_paths(data: Any) -> Any:
    """Make each ``path`` of an override absolute: it is relative to where the command runs."""
    if isinstance(data, dict):
        return {
            key: str(Path(value).expanduser().resolve())
            if key == "path" and isinstance(value, str)
            else _absolute_paths(value)
            for key, value in data.items()
        }
    return [_absolute_paths(item) for item in data] if isinstance(data, list) else data


def _validate(draft: _Draft) -> Scenario:
    try:
        # JSON mode is the strict one that still takes lists for tuples and text for paths.
        return Scenario.model_validate_json(json.dumps(draft.data, default=str), strict=True)
    except ValidationError as error:
        raise ScenarioError(_problems(draft, error)) from None


def _problems(draft: _Draft, error: ValidationError) -> list[str]:
    """One sentence a problem: of a union's branches only those that the value could have meant."""
    found: dict[Key, list[tuple[bool, str]]] = {}
    conflicts: list[str] = []
    for detail in error.errors():
        key, model = _plain_key(detail["loc"], draft.data)
        cause = detail.get("ctx", {}).get("error")
        if isinstance(cause, ConflictError):
            conflicts += (_blamed(draft, key, conflict) for conflict in cause.conflicts)
            continue
        if detail["type"] == "union_tag_invalid" and _exists(draft.data, [*key, "kind"]):
            key = (*key, "kind")
        wrong_shape = detail["type"].endswith("_type") or detail["type"] == "too_short"
        found.setdefault(key, []).append((wrong_shape, _sentence(detail, key, model)))
    sentences = []
    for key, parts in found.items():
        deeper = any(len(other) > len(key) and other[: len(key)] == key for other in found)
        meant = [text for wrong_shape, text in parts if not wrong_shape]
        if not meant and not deeper:
            meant = [text for _, text in parts]
        if meant:
            sentences.append(_place(draft, key) + " or ".join(dict.fromkeys(meant)))
    return sentences + conflicts


def _blamed(draft: _Draft, section: Key, conflict: Conflict) -> str:
    """A conflict at the place of the last of its keys that was set."""
    origin = draft.last_origin((*section, *_key(key)) for key in conflict.keys)
    return _prefix(origin, section) + conflict.message


def _place(draft: _Draft, key: Key) -> str:
    return _prefix(draft.origin(key), key)


def _prefix(origin: str, key: Key) -> str:
    return (f"{origin}: " if origin else "") + (".".join(map(str, key)) + ": " if key else "")


_PLAIN = {
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number",
    "float_type": "must be a number",
    "finite_number": "must be a finite number",
    "string_type": "must be text",
    "bool_type": "must be true or false",
    "tuple_type": "must be a list",
    "list_type": "must be a list",
    "path_type": "must be the name of a file",
    "dict_type": "must be a mapping of names to values",
    "model_type": "must be a section of keys and values",
    "model_attributes_type": "must be a section of keys and values",
}
"""What pydantic's kinds of error mean to a user."""


def _sentence(detail: Any, key: Key, model: type[BaseModel] | None) -> str:
    kind, given = detail["type"], detail["input"]
    if kind == "extra_forbidden":
        known = list(model.model_fields) if model else []
        near = difflib.get_close_matches(str(key[-1]), known, n=1, cutoff=0.5)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        if "." in str(key[-1]):
            hint = "; a file nests its keys, dots are for --set"
        return f"unknown key{hint}" + (f" (known: {', '.join(known)})" if known else "")
    if kind == "missing":
        return "this key is needed and missing"
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        allowed = detail["ctx"].get("expected_tags", "")
        given = given.get("kind") if isinstance(given, dict) else given
        return f"kind {given!r} is not one of {allowed}" if allowed else "this key needs a 'kind'"
    if kind in ("too_short", "too_long"):
        limit = detail["ctx"].get("min_length", detail["ctx"].get("max_length"))
        side = "at least" if kind == "too_short" else "at most"
        has = len(given) if isinstance(given, list | tuple) else detail["ctx"]["actual_length"]
        return f"must have {side} {limit} {'entry' if limit == 1 else 'entries'}, but has {has}"
    if kind in _PLAIN:
        return f"{_PLAIN[kind]}, but is {'empty' if given is None else repr(given)}"
    message = detail["msg"].removeprefix("Value error, ")
    message = message.replace("Input should be", "must be")
    return message if kind == "value_error" else f"{message}, but is {given!r}"


def _plain_key(location: tuple[str | int, ...], data: Any) -> tuple[Key, type[BaseModel] | None]:
    """Drop from a pydantic location what is no key: tags and names of union branches."""
    key: list[str | int] = []
    annotation: Any = Scenario
    model: type[BaseModel] | None = Scenario
    for step in location:
        models = _models(annotation)
        tag = next((m for m in models if _tag(m) == step), None)
        if tag is not None and len(models) > 1:
            annotation = model = tag
            continue
        if isinstance(step, int):
            key.append(step)
            annotation = _item(annotation)
            continue
        owner = models[0] if models else None
        if owner is not None and step in owner.model_fields:
            key.append(step)
            model, annotation = owner, owner.model_fields[step].annotation
            continue
        if owner is not None and _exists(data, [*key, step]):
            key.append(step)
            model = owner
            continue
        if step in _names(annotation):
            annotation = next(m for m in models if m.__name__ == step)
            model = annotation
    return tuple(key), model


def _exists(data: Any, key: list[str | int]) -> bool:
    for step in key:
        try:
            data = data[step]
        except (KeyError, IndexError, TypeError):
            return False
    return True


def _models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [m for arg in typing.get_args(annotation) for m in _models(arg)]


def _names(annotation: Any) -> list[str]:
    return [m.__name__ for m in _models(annotation)]


def _item(annotation: Any) -> Any:
    for arg in typing.get_args(annotation):
        if arg is not Ellipsis and _models(arg):
            return arg
    return None


def _tag(model: type[BaseModel]) -> str | None:
    kind = model.model_fields.get("kind")
    tags = typing.get_args(kind.annotation) if kind else ()
    return tags[0] if tags else None
