"""Reader for one frame of a CTSimU file: units, drifts, and a record of unread keys.

The format is https://bamresearch.github.io/ctsimu-scenarios, version 1.2. A parameter is an object
with ``value``, ``unit``, ``uncertainty`` and ``drifts``. A drift is an absolute deviation from the
value at equidistant moments from the first to the last frame, linear in between; several drifts add
up. If the value is a text, a drift replaces it and holds until the next moment.

A section records the keys that were read. Any other key is unknown to the format or not supported:
a problem, as it would otherwise be ignored.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from twinct.core.files.boundary import ABSENT, no_file
from twinct.core.foreign_text import shortened
from twinct.ctsimu.drifts import as_float, drift_values, interpolated, short
from twinct.ctsimu.ranges import ANY, Interval

UNITS: Mapping[str, Mapping[str | None, float]] = {
    "mm": {"nm": 1e-6, "um": 1e-3, "mm": 1.0, "cm": 10.0, "dm": 100.0, "m": 1000.0},
    "rad": {"rad": 1.0, "deg": math.pi / 180},
    "deg": {"deg": 1.0, "rad": 180 / math.pi},
    "s": {"ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0},
    "mA": {"uA": 1e-3, "mA": 1.0, "A": 1e3},
    "kV": {"V": 1e-3, "kV": 1.0, "MV": 1e3},
    "g/cm^3": {"g/cm^3": 1.0, "kg/m^3": 1e-3},
    "px": {"px": 1.0, None: 1.0},
    "1/J": {"1/J": 1.0, None: 1.0},
    "deg/s": {"deg/s": 1.0},
    "": {None: 1.0, "relative": 1.0},
}
"""Factor from each unit to our unit, which is the key."""

MOST_HINTS = 100
"""Largest number of unknown keys whose likely meaning is searched for, which takes time."""

_PARAMETER_KEYS = {"value", "unit", "uncertainty", "drifts", "comment"}
_DRIFT_KEYS = {"value", "file", "unit", "known_to_reconstruction", "comment"}


@dataclass(frozen=True)
class Moment:
    """Frame number, from 0 and with fractions between two frames; executed or believed."""

    frame: float
    frames: int
    believed: bool = False


@dataclass
class JsonSection:
    """A JSON object of the file, read at one moment.

    Attributes:
        data: the object.
        place: its dotted key, for messages.
        moment: moment of the scan.
        folder: base folder of relative file names.
        problems: collects one sentence for each error or unsupported feature, as its keys.
    """

    data: Mapping[str, Any]
    place: str
    moment: Moment
    folder: Path
    problems: dict[str, None]
    _read: set[str] = field(default_factory=set)
    _may_be_empty: set[str] = field(default_factory=set)
    _missing: list[str] = field(default_factory=list)
    _inner: dict[str, JsonSection] = field(default_factory=dict)

    def has(self, key: str) -> bool:
        """Return True if the key is present and not empty."""
        return not _says_nothing(self.data.get(key))

    def section(self, key: str, *, needed: bool = False) -> JsonSection:
        """Return the object below a key; an empty one if it is missing or null.

        A missing object that is needed does not report its own keys.
        """
        self._read.add(key)
        value = self.data.get(key)
        quiet = value is None and needed
        if quiet:
            self.require(key)
        elif value is not None and not isinstance(value, Mapping):
            self.problem(key, f"{short(value)} is not an object")
            value, quiet = None, True
        return self._below(key, value or {}, quiet=quiet)

    def sections(self, key: str) -> list[JsonSection]:
        """Return the objects of the array below a key."""
        self._read.add(key)
        value = self.data.get(key)
        if value is None:
            return []
        if not isinstance(value, list) or not all(isinstance(v, Mapping) for v in value):
            self.problem(key, "is not an array of objects")
            return []
        return [self._below(f"{key}[{i}]", item) for i, item in enumerate(value)]

    def number(self, key: str, unit: str = "", allowed: Interval = ANY) -> float | None:
        """Return a number in our unit with its drifts; None if it is missing, null, or invalid."""
        parameter = self._parameter(key, unit)
        if parameter is None:
            return None
        value, drifts, scale = parameter
        if isinstance(value, bool) or not isinstance(value, int | float):
            self.problem(key, f"{short(value)} is not a number")
            return None
        total = as_float(value) * scale
        if not math.isfinite(total):
            self.problem(key, "holds a value that is not finite")
            return None
        total += sum(self._drifted(key, drift, unit, scale) for drift in drifts)
        if total not in allowed:
            self.problem(key, f"{' '.join((f'{total:g}', unit)).strip()} must be {allowed}")
            return None
        return total

    def drift(self, key: str, unit: str = "") -> float:
        """Return the sum of a number's drifts, without the number."""
        parameter = self._parameter(key, unit)
        if parameter is None:
            return 0.0
        return sum(self._drifted(key, drift, unit, parameter[2]) for drift in parameter[1])

    def needed(self, key: str, unit: str = "", allowed: Interval = ANY) -> float:
        """Return a required number; report a missing or invalid one, and return NaN."""
        value = self.number(key, unit, allowed)
        self.require(key)
        return math.nan if value is None else value

    def whole(self, key: str, default: int, unit: str = "", allowed: Interval = ANY) -> int:
        """Return an integer, or the default."""
        value = self.number(key, unit, allowed)
        if value is None:
            return default
        if value != round(value):
            self.problem(key, f"{value:g} is not a whole number")
            return default
        return round(value)

    def flag(self, key: str, default: bool) -> bool:
        """Return a truth value, or the default."""
        self._read.add(key)
        value = self.data.get(key)
        if isinstance(value, Mapping):
            self._only(key, value, _PARAMETER_KEYS)
            value = value.get("value")
        if value is None:
            return default
        if not isinstance(value, bool):
            self.problem(key, f"{short(value)} is neither true nor false")
            return default
        return value

    def text(self, key: str, allowed: tuple[str, ...] | None = None) -> str | None:
        """Return a text, or the last drift in its place; None if it is missing or null."""
        parameter = self._parameter(key, "")
        if parameter is None:
            return None
        value, drifts, _ = parameter
        if not isinstance(value, str):
            self.problem(key, f"{short(value)} is not a text")
            return None
        for drift in drifts:
            values = self._values(key, drift, as_text=True)
            if values:
                value = values[int(math.floor(self._position(len(values))))]
        if allowed is not None and value not in allowed:
            self.problem(key, f"{short(value)} is not supported; allowed: {', '.join(allowed)}")
        return value or None

    def file(self, key: str) -> Path | None:
        """Return the path of a file that the scenario refers to; report a missing file."""
        name = self.text(key)
        if name is None:
            return None
        path = self.folder / name.replace("\\", "/")
        try:
            path = path.resolve()
            why = no_file(path)
        except (OSError, RuntimeError, ValueError):  # a name that no file can have
            why = ABSENT
        if why:
            self.problem(key, f"no file at {path}" if why == ABSENT else f"{path} {why}")
        return None if why else path

    def skip(self, *keys: str) -> None:
        """Mark keys as read that change nothing in an image."""
        self._read.update(keys)

    def may_be_empty(self, *keys: str) -> None:
        """Declare keys of the format that are not read here: they may be present if empty."""
        self._may_be_empty.update(keys)

    def problem(self, key: str, sentence: str) -> None:
        """Report a problem with a key."""
        self.problems[f"{self._place_of(key)}: {sentence}"] = None

    def require(self, *keys: str) -> None:
        """Record required keys; ``finish`` reports the empty ones, unless one is misspelt."""
        self._missing += [k for k in keys if k not in self._missing and not self.has(k)]

    def finish(self) -> None:
        """Report every missing key and every unread key, here and below."""
        known = self._read | self._may_be_empty
        unread = [key for key in self.data if key not in self._read and key != "comment"]
        strange = [key for key in unread if key not in self._may_be_empty]
        near = {key: _nearest(key, known) for key in strange[:MOST_HINTS]}
        for key in self._missing:
            if key not in near.values():
                self.problem(key, "is missing")
        for key in unread:
            if key in near:
                self.problem(key, _unknown(near[key]))
            elif self.has(key):
                self.problem(key, "is not supported here")
        for inner in self._inner.values():
            inner.finish()

    def _place_of(self, key: str) -> str:
        return ".".join(part for part in (self.place, shortened(key, 80)) if part)

    def _below(self, key: str, data: Mapping[str, Any], *, quiet: bool = False) -> JsonSection:
        place, problems = self._place_of(key), {} if quiet else self.problems
        below = JsonSection(data, place, self.moment, self.folder, problems)
        return self._inner.setdefault(key, below)

    def _parameter(self, key: str, unit: str) -> tuple[Any, list[Mapping[str, Any]], float] | None:
        """Return value, drifts that apply at this moment, and the scale of the unit."""
        self._read.add(key)
        data = self.data.get(key)
        if data is None:
            return None
        if not isinstance(data, Mapping):
            return data, [], 1.0
        self._only(key, data, _PARAMETER_KEYS)
        drifts = data.get("drifts")
        drifts = [] if _says_nothing(drifts) else drifts
        if not isinstance(drifts, list) or not all(isinstance(d, Mapping) for d in drifts):
            self.problem(f"{key}.drifts", "is not an array of objects")
            drifts = []
        for drift in drifts:
            self._only(f"{key}.drifts", drift, _DRIFT_KEYS)
            known = drift.get("known_to_reconstruction")
            if not isinstance(known, bool | None):
                where = f"{key}.drifts.known_to_reconstruction"
                self.problem(where, f"{short(known)} is neither true nor false")
        if self.moment.believed:
            drifts = [d for d in drifts if d.get("known_to_reconstruction") is not False]
        value = data.get("value")
        if value is None:
            if any(not _says_nothing(drift.get("value")) or drift.get("file") for drift in drifts):
                self.problem(key, "has drifts, but no value")
            return None
        scale = self._scale(key, unit, data.get("unit"))
        return None if scale is None else (value, drifts, scale)

    def _scale(self, key: str, unit: str, given: Any) -> float | None:
        allowed = UNITS[unit]
        if isinstance(given, str | None) and given in allowed:
            return allowed[given]
        names = ", ".join("null" if name is None else name for name in allowed)
        self.problem(key, f"unit {short(given)} is not one of {names}")
        return None

    def _drifted(self, key: str, drift: Mapping[str, Any], unit: str, scale: float) -> float:
        values = self._values(key, drift)
        if not values:
            return 0.0
        if drift.get("unit") is not None:
            scale = self._scale(f"{key}.drifts", unit, drift["unit"]) or 0.0
        return scale * interpolated(values, self._position(len(values)))

    def _position(self, count: int) -> float:
        """Return the index into a list of drift values that spans the scan."""
        if count < 2 or self.moment.frames < 2:
            return 0.0
        return self.moment.frame / (self.moment.frames - 1) * (count - 1)

    def _values(self, key: str, drift: Mapping[str, Any], *, as_text: bool = False) -> list[Any]:
        try:
            return drift_values(drift, self.folder, as_text=as_text)
        except ValueError as error:
            self.problem(f"{key}.drifts", str(error))
            return []

    def _only(self, key: str, data: Mapping[str, Any], known: set[str]) -> None:
        for name in data:
            if name not in known:
                hint = _nearest(name, known) if len(self.problems) < MOST_HINTS else None
                self.problem(f"{key}.{name}", _unknown(hint))


def _nearest(key: str, known: set[str]) -> str | None:
    return next(iter(difflib.get_close_matches(key, sorted(known), n=1, cutoff=0.6)), None)


def _unknown(nearest: str | None) -> str:
    return f"unknown key; did you mean {nearest!r}?" if nearest else "unknown key"


def _says_nothing(value: Any) -> bool:
    """Return True if a value is null, empty, or an object of such values."""
    if isinstance(value, Mapping):
        return all(_says_nothing(v) for k, v in value.items() if k not in ("unit", "comment"))
    if isinstance(value, list):
        return all(_says_nothing(v) for v in value)
    return value is None or value == ""
