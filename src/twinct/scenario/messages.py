"""Messages about an invalid scenario: one clear sentence for each problem."""

from __future__ import annotations

import difflib
import re
import reprlib
import typing
from collections.abc import Callable
from typing import Any, NamedTuple

from pydantic import BaseModel, ValidationError

from twinct.core.errors import ScenarioError
from twinct.core.extensions import Registry
from twinct.core.foreign_text import quoted, shortened
from twinct.core.settings import Conflict, ConflictError, annotation_of, models_in
from twinct.evaluation.figure_kinds import figure_kinds
from twinct.recon.algorithms import algorithms
from twinct.scenario.reading import KIND_KEYS, Draft, Key, is_list, key_of
from twinct.scenario.scenario import Scenario
from twinct.specimen.sections.specimen import part_kinds
from twinct.trajectory.families import families
from twinct.uncertainty.sections import error_terms
from twinct.view_planning.task import usable_objectives

_REGISTRIES: dict[Key, Callable[[], Registry[Any]]] = {
    ("reconstruction", "algorithm"): algorithms,
    ("trajectory", "kind"): families,
    ("specimen", "parts"): part_kinds,
    ("task",): usable_objectives,
    ("evaluation",): figure_kinds,
    ("uncertainty",): error_terms,
}
"""Extensions, at the keys that name or have them."""

MOST_PROBLEMS = 50
"""Largest number of problems that get a sentence; a file with more is probably no scenario."""


def refusal(
    draft: Draft, error: ValidationError, root: type[BaseModel] = Scenario
) -> ScenarioError:
    """Return the error with one sentence per problem of the validated model ``root``.

    In a union, only the branches that the value could have meant are reported.
    """
    problems: dict[Key, list[tuple[bool, str]]] = {}
    conflicts: list[str] = []
    in_conflict: list[Key] = []
    details = error.errors(include_url=False)
    if details[0]["type"] == "json_invalid":
        return ScenarioError(
            "a path or text is not UTF-8: rename the file or folder, or set LANG to C.UTF-8: "
            f"{shortened(details[0]['msg'])}"
        )
    for detail in details[:MOST_PROBLEMS]:
        key, model, others = _plain_key(detail["loc"], draft.data, root)
        if detail["type"] == "missing" and isinstance(key[-1], int):  # a list that is too short
            key = key[:-1]
        cause = detail.get("ctx", {}).get("error")
        if isinstance(cause, ConflictError):
            conflicts += (_blamed(draft, key, conflict) for conflict in cause.conflicts)
            in_conflict.append(key)
            continue
        if detail["type"] == "union_tag_invalid":
            by = detail.get("ctx", {})["discriminator"]
            key = (*key, next((tag for tag in KIND_KEYS if tag in by), "algorithm"))
        wrong_shape = detail["type"].endswith("_type") or detail["type"] == "too_short"
        problems.setdefault(key, []).append((wrong_shape, _sentence(detail, key, model, others)))
    sentences: list[str] = []
    for key, parts in problems.items():
        others = (*problems, *in_conflict)
        deeper = any(len(other) > len(key) and other[: len(key)] == key for other in others)
        meant = [text for wrong_shape, text in parts if not wrong_shape]
        if not meant and not deeper:
            meant = [text for _, text in parts]
        if meant:
            sentences.append(place(draft, key) + _either(list(dict.fromkeys(meant))))
    return ScenarioError([*sentences, *conflicts], max(len(details) - MOST_PROBLEMS, 0))


def _either(texts: list[str]) -> str:
    """Return one text for several, joined if they differ only in the type that they ask for."""
    parts = [text.partition(", but is ") for text in texts]
    alike = len({given for _, _, given in parts}) == 1
    if len(texts) == 1 or not alike or not all(text.startswith("must be ") for text in texts):
        return " or ".join(texts)
    bounds = " or ".join(text.removeprefix("must be ") for text, _, _ in parts)
    return f"must be {bounds}, but is {parts[0][2]}"


def _blamed(draft: Draft, section: Key, conflict: Conflict) -> str:
    """Return the message of a conflict, placed at the last of its keys that was set."""
    origin = draft.last_origin((*section, *key_of(key)) for key in conflict.keys)
    return _prefix(origin, section) + conflict.message


def place(draft: Draft, key: Key) -> str:
    """Return the beginning of a message about a key: its origin and its name."""
    return _prefix(draft.origin(key), key)


def _prefix(origin: str, key: Key) -> str:
    name = ".".join(shortened(str(step), 60) for step in key)
    return "".join(f"{part}: " for part in (origin, name) if part)


def shown(value: Any) -> str:
    """Return a value as text for a message, shortened if it is long."""
    if isinstance(value, str | int | float):
        return quoted(value)
    return shortened(reprlib.repr(value), 80)


_PLAIN = {
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number",
    "float_type": "must be a number",
    "finite_number": "must be a finite number",
    "string_type": "must be text",
    "bool_type": "must be true or false",
    "tuple_type": "must be a list",
    "list_type": "must be a list",
    "path_type": "must be a file name",
    "dict_type": "must be a mapping of names to values",
    "model_type": "must be a section of keys and values",
    "model_attributes_type": "must be a section of keys and values",
}
"""Texts for users, by pydantic's type of error."""

PATTERNS = {
    r"^[A-Za-z0-9_-]+$": "must consist of letters, digits, - and _, without spaces",
    r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$": "must consist of letters, digits, ., - and _, begin with "
    "a letter or a digit, and have at most 64 characters",
    r"^#([0-9a-fA-F]{6}|[0-9a-fA-F]{8})$": "must be a colour such as '#c8d0d8', or '#c8d0d880' "
    "with opacity",
}
"""Patterns of names, in words."""


class _Place(NamedTuple):
    """Place of a problem in the models: the section there, and the sections that could be there."""

    key: Key
    model: type[BaseModel] | None
    others: list[type[BaseModel]]


def _sentence(
    detail: Any, key: Key, model: type[BaseModel] | None, others: list[type[BaseModel]]
) -> str:
    kind: str = detail["type"]
    given: Any = detail["input"]
    if kind == "extra_forbidden":
        broken = _why_broken(key[:-1], str(key[-1]))
        return broken or _unknown_key(key, model, others)
    if kind == "missing" and is_list(given):
        length = _length(model, key) or detail["loc"][-1] + 1
        return f"must have {length} entries, but has {len(given)}: {shown(given)}"
    if kind == "missing":
        return "this required key is missing"
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        return _unknown_kind(detail["ctx"], key)
    if kind in ("too_short", "too_long"):
        limit = detail["ctx"].get("min_length", detail["ctx"].get("max_length"))
        side = "at least" if kind == "too_short" else "at most"
        has = len(given) if is_list(given) else detail["ctx"]["actual_length"]
        return f"must have {side} {limit} {'entry' if limit == 1 else 'entries'}, but has {has}"
    if words := PATTERNS.get(detail.get("ctx", {}).get("pattern")) or _PLAIN.get(kind):
        if kind == "tuple_type" and (length := _length(model, key)):
            words += f" of {length} entries"
        if kind in _SECTIONS:
            words += _example(model, key)
        return f"{words}, but is {'empty' if given is None else shown(given) + _point(given)}"
    if kind in _BOUNDS and (bounds := _both_bounds(model, key)):
        return f"must be {bounds}, but is {shown(given)}"
    message = detail["msg"].removeprefix("Value error, ").replace("Input should be", "must be")
    return message if kind == "value_error" else f"{message}, but is {shown(given)}"


_SECTIONS = ("dict_type", "model_type", "model_attributes_type")
"""Pydantic's types of error for a value in place of a section."""

_BOUNDS = ("greater_than", "greater_than_equal", "less_than", "less_than_equal")
"""Pydantic's types of error for a number beyond a bound."""


def _both_bounds(model: type[BaseModel] | None, key: Key) -> str:
    """Return both bounds of a key in words; nothing if it has one."""
    info = model.model_fields.get(str(key[-1])) if model else None
    bounds = {
        of: getattr(bound, name)
        for bound in (info.metadata if info else ())
        for name, of in (("gt", "above"), ("ge", "at least"), ("lt", "below"), ("le", "at most"))
        if getattr(bound, name, None) is not None
    }
    lower = next((f"{of} {bounds[of]}" for of in ("above", "at least") if of in bounds), "")
    upper = next((f"{of} {bounds[of]}" for of in ("below", "at most") if of in bounds), "")
    return f"{lower} and {upper}" if lower and upper else ""


def _length(model: type[BaseModel] | None, key: Key) -> int | None:
    """Return the number of entries of a key that is a list of fixed length; None for others."""
    info = model.model_fields.get(str(key[-1])) if model else None
    if info is None:
        return None
    annotations = [info.annotation, *typing.get_args(info.annotation)]
    lists = (typing.get_args(one) for one in annotations if typing.get_origin(one) is tuple)
    return next((len(one) for one in lists if one and Ellipsis not in one), None)


def _example(model: type[BaseModel] | None, key: Key) -> str:
    """Return the beginning of such a section, or nothing."""
    info = model.model_fields.get(str(key[-1])) if model else None
    tags = [tag for tag in map(_tag, models_in(annotation_of(info)) if info else ()) if tag]
    return f" such as {{kind: {tags[0]}}} (kinds: {', '.join(tags)})" if tags else ""


def _point(given: Any) -> str:
    """Return a hint for a number that is written with a decimal comma."""
    if not isinstance(given, str) or not re.fullmatch(r"[-+]?\d+,\d+", given[:40], re.ASCII):
        return ""
    return f"; numbers have a decimal point: {given.replace(',', '.')}"


def _unknown_key(key: Key, model: type[BaseModel] | None, others: list[type[BaseModel]]) -> str:
    known = list(model.model_fields) if model else []
    if having := [str(_tag(other)) for other in others if key[-1] in other.model_fields]:
        own, has = model and _tag(model), "has" if len(having) == 1 else "have"
        by = next(tag for tag in (*KIND_KEYS, "algorithm") if tag in known)
        tag = ".".join(map(str, (*key[:-1], by)))
        but = f"{own} has no such key, but {', '.join(having)} {has} it"
        return f"{but}: change {tag}, or use keys of {own} ({', '.join(known)})"
    hint = _nearest(str(key[-1]), known, 0.5)
    if "." in str(key[-1]):
        hint = "; nest keys in a file, dotted keys are for --set only"
    return f"unknown key{hint}" + (f" (known: {', '.join(known)})" if known else "")


def _why_broken(key: Key, name: str) -> str:
    """Return the reason why an extension cannot be used; nothing if no package offers it."""
    registry = _REGISTRIES.get(key)
    return registry().broken.get(name, "") if registry else ""


def _unknown_kind(data: Any, key: Key) -> str:
    if "tag" not in data:
        by = data["discriminator"]
        return f"this section needs the key {'method' if 'method' in by else 'kind'!r}"
    given, allowed = data["tag"], data["expected_tags"]
    if broken := _why_broken(key, str(given)):
        return broken
    hint = _nearest(given, allowed.replace("'", "").split(", "), 0.6)
    return f"{key[-1]} {shown(given)} is not one of {allowed}{hint}"


def _nearest(name: str, known: list[str], cutoff: float) -> str:
    near = difflib.get_close_matches(name, known, n=1, cutoff=cutoff)
    return f"; did you mean {near[0]!r}?" if near else ""


def _plain_key(location: tuple[str | int, ...], data: Any, root: type[BaseModel]) -> _Place:
    """Return the place of a pydantic location, without tags and names of union branches."""
    key: list[str | int] = []
    annotation: Any = root
    model: type[BaseModel] | None = root
    others: list[type[BaseModel]] = []
    for step in location:
        models = models_in(annotation)
        tagged = next((m for m in models if _tag(m) == step), None)
        owner = models[0] if models else None
        if tagged is not None and len(models) > 1:
            annotation, model, others = tagged, tagged, models
        elif isinstance(step, int):
            key.append(step)
            annotation = next((arg for arg in typing.get_args(annotation) if models_in(arg)), None)
        elif owner is not None and step in owner.model_fields:
            key.append(step)
            model, annotation, others = owner, annotation_of(owner.model_fields[step]), []
        elif owner is not None and _exists(data, [*key, step]):
            key.append(step)
            model = owner
        elif named := next((m for m in models if m.__name__ == step), None):
            annotation = model = named
    return _Place(tuple(key), model, others)


def _exists(data: Any, key: list[str | int]) -> bool:
    for step in key:
        try:
            data = data[step]
        except (KeyError, IndexError, TypeError):
            return False
    return True


def _tag(model: type[BaseModel]) -> str | None:
    """Return the ``kind``, ``method`` or ``algorithm`` that identifies a section, or None."""
    tags = (*KIND_KEYS, "algorithm")
    infos = (model.model_fields[tag] for tag in tags if tag in model.model_fields)
    return next((str(typing.get_args(info.annotation)[0]) for info in infos), None)
