"""Reading of YAML files and overrides into merged plain data with the origin of each key."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeGuard, cast

import numpy as np

from twinct.core.errors import ScenarioError
from twinct.core.files.boundary import ABSENT, absolute, no_file
from twinct.core.files.plain_yaml import Key, read_file_text, read_text, read_value
from twinct.core.foreign_text import quoted, shortened, whole_number
from twinct.core.settings import FILE_KEYS
from twinct.recon.sections.reconstruction import DEFAULT_ALGORITHM, SECTIONS, own_keys
from twinct.robots.sections.cell import DEFAULT_KIND
from twinct.scenario.catalogue import same_name, scenario_file
from twinct.scenario.objects import as_settings
from twinct.scenario.version_0_1 import upgraded

_SET = "--set "
"""Beginning of the origin of a key that an override set."""

LONGEST_CHAIN = 16
"""Largest number of files that extend one another."""

KIND_KEYS = ("kind", "method")
"""Keys that select one of several kinds of a section."""
DEFAULT_KINDS: dict[Key, str] = {("cell",): DEFAULT_KIND}
"""Kinds of the sections that may leave out their ``kind``."""


@dataclass
class Draft:
    """Merged raw data, and the origin of each key, in the order in which the keys were set.

    A section counts as set by the last file or override that set one of its keys, since that change
    caused any problem of the section as a whole. ``left_out`` has one sentence for each key that
    was dropped together with its algorithm. ``afresh`` has the keys that a section lost with its
    kind, and the override that changed it. ``overridden`` holds the keys that overrides set,
    ``beneath`` the origins in files that sections had before overrides of keys in them.
    """

    data: dict[str, Any] = field(default_factory=dict[str, Any])
    origins: dict[Key, str] = field(default_factory=dict[Key, str])
    left_out: list[str] = field(default_factory=list[str])
    afresh: dict[Key, tuple[str, tuple[str, ...]]] = field(
        default_factory=dict[Key, tuple[str, tuple[str, ...]]]
    )
    overridden: set[Key] = field(default_factory=set[Key])
    beneath: dict[Key, str] = field(default_factory=dict[Key, str])

    def set_over(self, key: Key) -> bool:
        """Return whether an override set a key, or one below or around it.

        A new kind keeps such keys.
        """
        around = (key[:depth] in self.overridden for depth in range(1, len(key) + 1))
        return any(around) or any(other[: len(key)] == key for other in self.overridden)

    def origin(self, key: Key) -> str:
        """Return the origin of a key, or of the nearest key around it.

        A section's last override explains a problem of another key only if it set the section's
        kind, or the section itself.
        """
        around = key
        while around and around not in self.origins:
            around = around[:-1]
        origin = self.origins.get(around, "")
        if around == key or not origin.startswith(_SET):
            return origin
        last = key_of(origin.removeprefix(_SET).partition("=")[0].strip())
        explains = key[: len(last)] == last or last[-1] in (*KIND_KEYS, "algorithm")
        return origin if explains else self.beneath.get(around, "")

    def record(self, places: Mapping[Key, str]) -> None:
        """Record the origins of keys as the latest ones."""
        for key, place in places.items():
            before = self.origins.pop(key, "")
            if not before.startswith(_SET):
                self.beneath[key] = before
            self.origins[key] = place

    def forget(self, key: Key) -> None:
        """Remove the origins of a key and of all keys below it."""
        self.origins = {k: v for k, v in self.origins.items() if k[: len(key)] != key}

    def last_origin(self, keys: Iterable[Key]) -> str:
        """Return the origin of the key that was set last; else of the section around them."""
        keys = list(keys)
        order = {key: rank for rank, key in enumerate(self.origins)}
        return self.origin(max(keys, key=lambda key: order.get(key, -1)))


Overrides = Iterable[str] | Mapping[str, Any]
"""``KEY=VALUE`` texts, or values by dotted key."""


@dataclass(frozen=True)
class ScenarioText:
    """Text of a scenario file that differs from the file, or is not saved yet.

    Attributes:
        path: the file; other files are named relative to its folder.
        text: the text.
    """

    path: Path
    text: str


Source = str | Path | Mapping[str, Any] | ScenarioText
"""A scenario file, the name of a built-in scenario, plain data, or the text of a file."""


def drafted(source: Source, overrides: Overrides = (), *, extends: bool = True) -> Draft:
    """Merge a scenario file and the files it extends, or plain data, with overrides.

    Without ``extends``, plain data may name no file to build on: the key stays, and is refused.

    Raises:
        ScenarioError: a file cannot be read, or an override has no valid key.
    """
    if isinstance(source, Mapping):
        own = Draft(_absolute_paths(_plain(source), Path()))
        draft = _extended(own, Path(), ()) if extends else Draft(upgraded(own.data))
    elif isinstance(source, ScenarioText):
        chain = (absolute(Path(), str(source.path)),)
        draft = _extended(keys_of(source), source.path.parent, chain)
    else:
        draft = _read(Path(source), ())
    if isinstance(overrides, Mapping):
        for key, value in cast("Mapping[str, Any]", overrides).items():
            name = key.rpartition(".")[2]
            _apply(draft, key, _absolute_paths(_plain({name: value}), Path())[name], "")
    else:
        for override in overrides:
            _apply_override(draft, override)
        # Python code that changes a kind knows the section.
        draft.left_out += _without_former_keys(draft)
    return draft


def _plain(value: Any) -> Any:
    """Return values of Python and numpy as the plain data that YAML holds."""
    if isinstance(value, Mapping):
        pairs = cast("Mapping[object, object]", value)
        return {str(key): _plain(as_settings(str(key), one)) for key, one in pairs.items()}
    if isinstance(value, np.ndarray | np.generic):
        return cast(Any, value).tolist()
    if isinstance(value, list | tuple):
        return [_plain(one) for one in cast("Iterable[object]", value)]
    return str(value) if isinstance(value, Path) else value


def varied(draft: Draft, changes: Mapping[str, Any], places: Mapping[str, str]) -> Draft:
    """Return a copy of a draft with some keys changed, as by overrides.

    Args:
        draft: the draft to copy; it stays unchanged.
        changes: dotted keys and plain values, applied in this order.
        places: origin of each of these keys, as stated in messages.

    Raises:
        ScenarioError: a key leads through a plain value or to a missing list index.
    """
    changed = Draft(
        copy.deepcopy(draft.data), dict(draft.origins), overridden=set(draft.overridden)
    )
    changed.beneath = dict(draft.beneath)
    for key, value in changes.items():
        _apply(changed, key, value, places[key])
    return changed


def read_yaml(path: Path, what: str) -> Draft:
    """Read the keys of one file, each with its line. Messages call the file ``what``.

    Paths in the file become absolute.

    Raises:
        ScenarioError: the file cannot be read, or is no mapping.
    """
    return keys_of(ScenarioText(path, read_file_text(path, what)), what)


def keys_of(source: ScenarioText, what: str = "scenario") -> Draft:
    """Return the keys of one text alone, without the file that it extends.

    Raises:
        ScenarioError: the text is no mapping of plain data.
    """
    path = source.path
    read = read_text(source.text, path, what)
    if read.value is None:
        raise ScenarioError(f"{path}: the {what} is empty")
    if not is_mapping(read.value):
        raise ScenarioError(f"{path}: a {what} must be a mapping of keys to values")
    places = {key: f"{path}:{line}" for key, line in read.lines.items()}
    return Draft(_absolute_paths(read.value, path.parent, places), places)


def key_of(dotted: str) -> Key:
    """Split a dotted key into its steps."""
    steps = ((whole_number(step), step) for step in dotted.split("."))
    return tuple(step if number is None else number for number, step in steps)


def is_mapping(data: object) -> TypeGuard[dict[str, Any]]:
    """Return whether data is a mapping, and narrow its type."""
    return isinstance(data, dict)


def is_list(data: object) -> TypeGuard[list[Any]]:
    """Return whether data is a list, and narrow its type."""
    return isinstance(data, list)


def _read(path: Path, chain: tuple[Path, ...]) -> Draft:
    try:
        absolute(Path(), str(path))
    except ValueError as error:
        raise ScenarioError(str(error)) from None
    path = scenario_file(path.expanduser())
    seen = absolute(Path(), str(path))
    if seen in chain:
        raise ScenarioError(f"{path}: extends itself: " + " -> ".join(p.name for p in chain))
    if len(chain) >= LONGEST_CHAIN:
        raise ScenarioError(
            f"{path}: too many files extend one another; at most {LONGEST_CHAIN} are allowed"
        )
    if no_file(path) == ABSENT and (hint := same_name(path)):
        raise ScenarioError(f"{path}: the scenario {ABSENT}{hint}")
    return _extended(read_yaml(path, "scenario"), path.parent, (*chain, seen))


def _extended(own: Draft, folder: Path, chain: tuple[Path, ...]) -> Draft:
    """Merge a draft with the file that it extends, if any, relative to a folder."""
    own.data = upgraded(own.data)
    parent = own.data.pop("extends", None)
    if parent is None:
        return own
    origin = own.origin(("extends",))
    place = f"{origin}: extends: " if origin else "extends: "
    if not isinstance(parent, str):
        raise ScenarioError(f"{place}{quoted(parent)} is not a file name")
    file = scenario_file(Path(parent), folder, place)
    if why := no_file(file):
        name = shortened(str(file), 300)
        problem = f"no file at {name}{same_name(file)}" if why == ABSENT else f"{name} {why}"
        raise ScenarioError(place + problem)
    base = _read(file, chain)
    if own.data and base.data.pop("description", None) is not None:  # it describes another one
        base.forget(("description",))
    _merge(base, own.data, own.origins, ())
    return base


def _merge(base: Draft, data: dict[str, Any], origins: dict[Key, str], key: Key) -> None:
    """Merge data into the draft: combine mappings, replace all else, restart at a new ``kind``."""
    here: Any = base.data
    for step in key:
        here = here[step]
    for name, value in data.items():
        inner, old = (*key, name), here.get(name)
        if is_mapping(old) and is_mapping(value):
            kinds = {tag: old.get(tag, DEFAULT_KINDS.get(inner)) for tag in KIND_KEYS}
            if all(value.get(tag, kind) == kind for tag, kind in kinds.items()):
                _change_algorithm(base, inner, value.get("algorithm"))
                _merge(base, value, origins, inner)
                base.record({inner: origins.get(inner, "")})
                continue
        here[name] = value
        base.forget(inner)
        base.record({inner: ""} | {k: v for k, v in origins.items() if k[: len(inner)] == inner})


def _apply_override(draft: Draft, override: str) -> None:
    key_text, equals, value_text = override.partition("=")
    place = _SET + shortened(override, 100)
    steps = key_text.strip().split(".")
    if not equals or not all(step.strip() for step in steps):
        raise ScenarioError(f"{place}: expected KEY=VALUE, such as detector.columns=320")
    name = steps[-1]
    value = _absolute_paths({name: read_value(value_text, place)}, Path(), {(): place})[name]
    _apply(draft, key_text.strip(), value, place)


def _apply(draft: Draft, dotted: str, value: Any, place: str) -> None:
    at = place or dotted
    if not all(step.strip() for step in dotted.split(".")):
        raise ScenarioError(f"{quoted(dotted)}: expected a dotted key, such as detector.columns")
    key, steps = key_of(dotted), dotted.split(".")
    here: Any = draft.data
    for depth, step in enumerate(steps):
        index = _index(here, step, f"{at}: {'.'.join(steps[:depth])}")
        if depth == len(steps) - 1:
            if is_mapping(here) and step in KIND_KEYS:
                if here.get(step, DEFAULT_KINDS.get(key[:-1], value)) != value:
                    _start_afresh(draft, here, key[:-1], place)
            if step == "algorithm":
                _change_algorithm(draft, key[:-1], value)
            here[index] = value
            break
        if is_mapping(here) and here.get(index) is None:  # absent or null: start a section
            here[index] = {}
        here = here[index]
    draft.forget(key)
    draft.overridden.add(key)
    draft.record({key[:depth]: place for depth in range(1, len(key) + 1)})


def _index(here: Any, step: str, place: str) -> Any:
    """Return the index of a step of a dotted key in a list, or its name in a mapping."""
    if is_mapping(here):
        return step
    if not is_list(here):
        raise ScenarioError(f"{place} is a value and has no keys")
    number = whole_number(step)
    if number is None or number >= len(here):
        what = f"{place} is a list of length {len(here)}"
        allowed = f" (0 to {len(here) - 1})" if len(here) else ""
        raise ScenarioError(f"{what}; {quoted(step)} is not a valid index{allowed}")
    return number


def _start_afresh(draft: Draft, section: dict[str, Any], key: Key, place: str) -> None:
    """Empty a section whose kind changes, except for keys that overrides have set."""
    dropped = [name for name in section if not draft.set_over((*key, name))]
    for name in dropped:
        del section[name]
        draft.forget((*key, name))
    draft.afresh[key] = place, tuple(name for name in dropped if name not in KIND_KEYS)


def _without_former_keys(draft: Draft) -> Iterator[str]:
    """Yield a sentence for each section that started afresh, and what it lost on the way."""
    for key, (place, names) in draft.afresh.items():
        # Another override may have replaced the section since.
        if lost := [name for name in names if not draft.set_over((*key, name))]:
            yield (
                f"{place}: a new kind starts afresh, without the former {', '.join(lost)}; set "
                f"what you need with it, such as --set {'.'.join(map(str, key))}.{lost[0]}=..."
            )


def _change_algorithm(draft: Draft, key: Key, algorithm: Any) -> None:
    """Remove keys of the previous algorithm that the new one lacks, except overridden ones.

    Keys at the previous algorithm's default go, too, if the new one has another default: a run's
    own file holds all of them, and nobody chose them.
    """
    section = draft.data.get("reconstruction")
    if key != ("reconstruction",) or not is_mapping(section) or not isinstance(algorithm, str):
        return
    before = section.get("algorithm", DEFAULT_ALGORITHM)
    if algorithm not in SECTIONS or before == algorithm:
        return
    valid = SECTIONS[algorithm].model_fields
    others = {name for other in SECTIONS.values() for name in own_keys(other)}
    for name in [name for name in section if name in others and name not in valid]:
        if not draft.set_over((*key, name)):
            origin = draft.origin((*key, name))
            # Python code that changes a whole scenario has all defaults in it, which nobody chose.
            if origin or section[name] != SECTIONS[before].model_fields[name].default:
                place = f"{origin}: " if origin else ""
                draft.left_out.append(
                    f"{place}reconstruction.{name} does not apply to {algorithm} and is ignored"
                )
            del section[name]
            draft.forget((*key, name))
    former = SECTIONS[before].model_fields if before in SECTIONS else {}
    for name in [name for name in section if name in former and name in valid]:
        usual = former[name].default
        if section[name] == usual != valid[name].default and name != "algorithm":
            if not draft.set_over((*key, name)):
                del section[name]
                draft.forget((*key, name))


def _absolute_paths(
    data: Any, folder: Path, places: Mapping[Key, str] | None = None, key: Key = ()
) -> Any:
    """Return plain data in which each path, relative to a folder, is made absolute.

    Raises:
        ScenarioError: no file can have this name.
    """
    if is_list(data):
        items = enumerate(data)
        return [_absolute_paths(item, folder, places, (*key, i)) for i, item in items]
    if not is_mapping(data):
        return data
    results: dict[str, Any] = {}
    for name, value in data.items():
        inner = (*key, name)
        if name in FILE_KEYS and isinstance(value, str):
            try:
                results[name] = str(absolute(folder, value))
            except ValueError as error:
                at = (places or {}).get(inner) or (places or {}).get((), "")
                dotted = ".".join(map(str, inner))
                raise ScenarioError(f"{at + ': ' if at else ''}{dotted}: {error}") from None
        else:
            results[name] = _absolute_paths(value, folder, places, inner)
    return results
