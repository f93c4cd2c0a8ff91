"""Reading one frame of a CTSimU file: units, drifts, and what nobody asked for.

The format is that of https://bamresearch.github.io/ctsimu-scenarios, version 1.2. A parameter is an
object with ``value``, ``unit``, ``uncertainty`` and ``drifts``. A drift is an absolute deviation
from the value, given at equidistant moments between first and last frame, linear between them;
several add up. Where the value is a text, a drift replaces it and holds until the next.

A section notes what was read of it. What is left over and says something is a problem: it would
otherwise be ignored.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

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
    "": {None: 1.0, "relative": 1.0},
}
"""What each unit is in ours; the key is ours."""

_PARAMETER_KEYS = {"value", "unit", "uncertainty", "drifts", "comment"}
_DRIFT_KEYS = {"value", "file", "unit", "known_to_reconstruction", "comment"}


@dataclass(frozen=True)
class Moment:
    """Which frame, and whose view of it.

    Attributes:
        frame: counted from 0; fractions lie between two frames.
        frames: number of frames of the scan.
        believed: leave out what is not known to the reconstruction.
    """

    frame: float
    frames: int
    believed: bool = False


@dataclass
class Section:
    """A JSON object of the file, read at one moment.

    Attributes:
        data: the object.
        place: dotted key of the object, for messages.
        moment: when.
        folder: where the file lies; names of other files are relative to it.
        problems: collects one sentence for each thing that is wrong or not supported.
    """

    data: Mapping[str, Any]
    place: str
    moment: Moment
    folder: Path
    problems: list[str]
    _read: set[str] = field(default_factory=set)
    _inner: dict[str, Section] = field(default_factory=dict)

    def has(self, key: str) -> bool:
        """Whether the key is there and says something."""
        return not _says_nothing(self.data.get(key))

    def section(self, key: str) -> Section:
        """The object below a key; an empty one where it is missing or null."""
        self._read.add(key)
        value = self.data.get(key)
        if value is not None and not isinstance(value, Mapping):
            self.problem(key, f"{value!r} is no object")
            value = None
        return self._below(key, value or {})

    def sections(self, key: str) -> list[Section]:
        """The objects of the array below a key."""
        self._read.add(key)
        value = self.data.get(key)
        if value is None:
            return []
        if not isinstance(value, list) or not all(isinstance(v, Mapping) for v in value):
            self.problem(key, "is no array of objects")
            return []
        return [self._below(f"{key}[{i}]", item) for i, item in enumerate(value)]

    def number(self, key: str, unit: str = "") -> float | None:
        """A number in our unit, drifts added; None where it is missing or null."""
        found = self._parameter(key, unit)
        if found is None:
            return None
        value, drifts, scale = found
        if isinstance(value, bool) or not isinstance(value, int | float):
            self.problem(key, f"{value!r} is no number")
            return None
        total = float(value) * scale
        for drift in drifts:
            total += self._drifted(key, drift, unit, scale)
        return total

    def drift(self, key: str, unit: str = "") -> float:
        """The sum of the drifts of a number alone."""
        found = self._parameter(key, unit)
        if found is None:
            return 0.0
        return sum(self._drifted(key, drift, unit, found[2]) for drift in found[1])

    def needed(self, key: str, unit: str = "") -> float:
        """A number that must be there; 0 after noting that it is missing."""
        value = self.number(key, unit)
        if value is None:
            if self.has(key):
                return 0.0  # noted already
            self.problem(key, "is missing")
            return 0.0
        return value

    def whole(self, key: str, default: int, unit: str = "") -> int:
        """A whole number."""
        value = self.number(key, unit)
        if value is None:
            return default
        if value != round(value):
            self.problem(key, f"{value:g} is no whole number")
        return int(round(value))

    def flag(self, key: str, default: bool) -> bool:
        """True or false."""
        self._read.add(key)
        value = self.data.get(key)
        if value is None:
            return default
        if isinstance(value, Mapping):
            value = value.get("value", default)
        if not isinstance(value, bool):
            self.problem(key, f"{value!r} is neither true nor false")
            return default
        return value

    def text(self, key: str, allowed: tuple[str, ...] | None = None) -> str | None:
        """A text, the last drift that has one taken; None where it is missing or null."""
        found = self._parameter(key, "")
        if found is None:
            return None
        value, drifts, _ = found
        for drift in drifts:
            values = self._drift_values(key, drift, as_text=True)
            if values:
                value = values[int(math.floor(self._position(len(values))))]
        if not isinstance(value, str):
            self.problem(key, f"{value!r} is no text")
            return None
        if allowed is not None and value not in allowed:
            self.problem(key, f"{value!r} is not supported; allowed: {', '.join(allowed)}")
        return value or None

    def file(self, key: str) -> Path | None:
        """A file the scenario refers to; it must exist."""
        name = self.text(key)
        if name is None:
            return None
        path = (self.folder / name.replace("\\", "/")).resolve()
        if not path.is_file():
            self.problem(key, f"no file at {path}")
            return None
        return path

    def skip(self, *keys: str) -> None:
        """Note keys that change nothing in an image."""
        self._read.update(keys)

    def problem(self, key: str, sentence: str) -> None:
        """Note what is wrong with a key."""
        message = f"{self.place}.{key}: {sentence}" if self.place else f"{key}: {sentence}"
        if message not in self.problems:
            self.problems.append(message)

    def finish(self) -> None:
        """Note every key that says something and that nobody read, here and below."""
        for key in self.data:
            if key not in self._read and key != "comment" and self.has(key):
                self.problem(key, "is not supported")
        for inner in self._inner.values():
            inner.finish()

    def _below(self, key: str, data: Mapping[str, Any]) -> Section:
        if key not in self._inner:
            place = f"{self.place}.{key}" if self.place else key
            self._inner[key] = Section(data, place, self.moment, self.folder, self.problems)
        return self._inner[key]

    def _parameter(self, key: str, unit: str) -> tuple[Any, list[Mapping[str, Any]], float] | None:
        """Value, drifts that count at this moment, and the scale of the unit."""
        self._read.add(key)
        data = self.data.get(key)
        if data is None:
            return None
        if not isinstance(data, Mapping):
            return data, [], 1.0
        self._only(key, data, _PARAMETER_KEYS)
        drifts = data.get("drifts") or []
        if not isinstance(drifts, list) or not all(isinstance(d, Mapping) for d in drifts):
            self.problem(f"{key}.drifts", "is no array of objects")
            drifts = []
        for drift in drifts:
            self._only(f"{key}.drifts", drift, _DRIFT_KEYS)
        if self.moment.believed:
            drifts = [d for d in drifts if d.get("known_to_reconstruction") is not False]
        value = data.get("value")
        if value is None:
            return None
        return value, drifts, self._scale(key, unit, data.get("unit"))

    def _scale(self, key: str, unit: str, given: Any) -> float:
        allowed = UNITS[unit]
        if given in allowed:
            return allowed[given]
        names = ", ".join("null" if name is None else name for name in allowed)
        self.problem(key, f"unit {given!r} is not one of {names}")
        return 1.0

    def _drifted(self, key: str, drift: Mapping[str, Any], unit: str, scale: float) -> float:
        values = self._drift_values(key, drift)
        if not values:
            return 0.0
        if drift.get("unit") is not None:
            scale = self._scale(f"{key}.drifts", unit, drift["unit"])
        place = self._position(len(values))
        left = min(max(int(math.floor(place)), 0), max(len(values) - 2, 0))
        right = min(left + 1, len(values) - 1)
        share = place - left
        return scale * ((1 - share) * values[left] + share * values[right])

    def _position(self, count: int) -> float:
        """Index into a list of drift values that spans the scan."""
        if count < 2 or self.moment.frames < 2:
            return 0.0
        return self.moment.frame / (self.moment.frames - 1) * (count - 1)

    def _drift_values(self, key: str, drift: Mapping[str, Any], as_text: bool = False) -> list[Any]:
        value = drift.get("value")
        if value is None and drift.get("file"):
            path = self.folder / str(drift["file"])
            try:
                value = [row[0].strip() for row in csv.reader(path.open()) if row]
                value = value if as_text else [float(cell) for cell in value]
            except (OSError, ValueError, UnicodeDecodeError) as error:
                self.problem(f"{key}.drifts", f"{path} cannot be read as one column: {error}")
                return []
        if value is None:
            return []
        values = value if isinstance(value, list) else [value]
        kind = str if as_text else (int, float)
        if any(isinstance(v, bool) or not isinstance(v, kind) for v in values):
            self.problem(f"{key}.drifts", f"{value!r} are no {'texts' if as_text else 'numbers'}")
            return []
        return values

    def _only(self, key: str, data: Mapping[str, Any], known: set[str]) -> None:
        for name, value in data.items():
            if name not in known and not _says_nothing(value):
                self.problem(f"{key}.{name}", "is not supported")


def _says_nothing(value: Any) -> bool:
    """Whether a value is null, empty, or an object of such values."""
    if isinstance(value, Mapping):
        return all(_says_nothing(v) for k, v in value.items() if k not in ("unit", "comment"))
    if isinstance(value, list):
        return all(_says_nothing(v) for v in value)
    return value is None or value == ""
