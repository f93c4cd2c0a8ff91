"""Values probably stated in a wrong unit: lengths that do not fit together, short times."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from twinct.scenario import Scenario
from twinct.specimen.size import UNITS_MM, SpecimenSize

FACTOR = 100.0
"""Largest ratio of a length to the median of those that belong together."""

SHORTEST_MS = 0.1
"""Shortest exposure of an X-ray tube: its voltage rises no faster."""


class _Length(NamedTuple):
    """One of the lengths that belong together, and the key that determines it."""

    mm: float
    key: str
    value: float
    what: str


def doubted_lengths(scenario: Scenario, size: SpecimenSize, to_middle_mm: float) -> list[str]:
    """Return a sentence for each length that is probably stated in a wrong unit.

    Specimen, field of view, grid, and distance from the source are of similar size. A length that
    differs from their median by more than ``FACTOR`` is doubted.

    Args:
        scenario: the scenario.
        size: sizes of specimen, field of view and grid.
        to_middle_mm: smallest distance from the source to the middle of the grid.
    """
    lengths = [one for one in _lengths(scenario, size) if one.mm > 0]  # 0: nothing is in the beam
    median = float(np.median([max(size.specimen_mm), to_middle_mm, *(one.mm for one in lengths)]))
    return [_doubt(one, median) for one in lengths if not 1 / FACTOR <= one.mm / median <= FACTOR]


def doubted_times(scenario: Scenario) -> list[str]:
    """Return a sentence if the exposure is shorter than a tube's can be."""
    exposure = scenario.source.exposure_ms
    if exposure >= SHORTEST_MS:
        return []
    return [
        f"source.exposure_ms is {exposure:g}, shorter than a tube can expose: "
        f"{1000 * exposure:g} would be {exposure:g} s"
    ]


def _lengths(scenario: Scenario, size: SpecimenSize) -> list[_Length]:
    section = scenario.reconstruction
    pitch, voxel = scenario.detector.panel.pitch_u, float(section.volume_grid.voxel.max())
    name = "grid" if section.zoom is None else "zoom"
    return [
        _Length(max(size.field_mm), "detector.pixel_pitch_mm", pitch, "the field of view"),
        _Length(max(size.grid_mm), f"reconstruction.{name}.voxel_mm", voxel, "the grid"),
    ]


def _doubt(one: _Length, median: float) -> str:
    unit = min(UNITS_MM, key=lambda name: abs(np.log(one.mm * UNITS_MM[name] / median)))
    scale = UNITS_MM[unit]
    return (
        f"{one.key} is {one.value:g}: {one.what} measures {one.mm:.3g} mm, but specimen and "
        f"distances about {median:.3g} mm; {one.value * scale:g} ({unit} taken for mm) would make "
        f"it {one.mm * scale:.3g} mm"
    )
