"""Parameters of a path as sliders: their keys, ranges and steps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from twinct.scenario import Scenario
from twinct.trajectory import OrbitSettings
from twinct.trajectory.families import families

RANGES: Mapping[str, tuple[float, float, float]] = {
    "views": (2, 400, 1),
    "sod_mm": (150, 900, 5),
    "sdd_mm": (300, 1500, 5),
    "centre_longitude_deg": (-180, 180, 1),
    "longitude_range_deg": (10, 360, 1),
    "latitude_deg": (-80, 80, 1),
    "latitude_amplitude_deg": (0, 80, 1),
    "periods": (0.5, 6, 0.5),
    "phase_deg": (-180, 180, 5),
    "tilt_deg": (-80, 80, 1),
    "azimuth_deg": (-180, 180, 1),
    "pitch_mm": (0, 200, 1),
    "turns": (1, 10, 1),
}
"""Smallest and largest value, and step, of the keys that sliders can set; others are typed."""

UNITS = ("mm", "deg")
"""Units at the ends of keys."""


@dataclass(frozen=True)
class Slider:
    """A number of the path.

    Attributes:
        name: key in the section ``trajectory``.
        value: present value.
        low: smallest value.
        high: largest value.
        step: step.
        hint: description of the key.
    """

    name: str
    value: float
    low: float
    high: float
    step: float
    hint: str

    @property
    def label(self) -> str:
        """Name for users, with the unit, such as ``longitude range, deg``."""
        stem, _, unit = self.name.rpartition("_")
        if unit not in UNITS:
            return self.name.replace("_", " ")
        words = stem.upper() if stem in ("sod", "sdd") else stem.replace("_", " ")
        return f"{words}, {unit}"

    @property
    def key(self) -> str:
        """Dotted key in the scenario."""
        return f"trajectory.{self.name}"


def sliders_of(scenario: Scenario) -> tuple[Slider, ...]:
    """Return the sliders of a scenario's path; none for views from a file."""
    section = scenario.trajectory
    return tuple(_sliders(section)) if isinstance(section, OrbitSettings) else ()


def _sliders(section: OrbitSettings) -> Iterator[Slider]:
    for name, field in type(section).model_fields.items():
        value = getattr(section, name)
        if name in RANGES and isinstance(value, int | float):
            low, high, step = RANGES[name]
            low, high = min(low, value), max(high, value)
            yield Slider(name, value, low, high, step, " ".join((field.description or "").split()))


def family_names() -> tuple[str, ...]:
    """Return the families of paths that a page can offer: those about an isocentre."""
    known = families()
    return tuple(name for name in known if issubclass(known[name].settings, OrbitSettings))


def of_family(scenario: Scenario, name: str) -> dict[str, Any]:
    """Return the keys that make the path one of another family, with what both have."""
    before = scenario.trajectory.model_dump(mode="json")
    fields = families()[name].settings.model_fields
    common = {key: value for key, value in before.items() if key in fields and key != "kind"}
    return {"trajectory": {"kind": name, **common}}
