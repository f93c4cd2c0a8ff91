"""A length or a time that is probably stated in a wrong unit is doubted, with the likely value."""

from __future__ import annotations

import pytest

from twinct.core.errors import InputError
from twinct.runs.checks import check_sight
from twinct.scan import SimulationBuilder
from twinct.scenario import load_scenario


def _doubts(changes: dict[str, object], name: str = "circle_gantry") -> list[str]:
    builder = SimulationBuilder(load_scenario(name, {"trajectory.views": 6} | changes))
    try:
        return [one for one in check_sight(builder) if " would " in one]
    except InputError as error:
        return [one for one in error.problems if " would " in one]


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("detector.pixel_pitch_mm", 0.002, "2 (metres taken for mm) would make it 160 mm"),
        ("detector.pixel_pitch_mm", 2000.0, "2 (micrometres taken for mm) would make it"),
        ("reconstruction.grid.voxel_mm", 0.00124, "1.24 (metres taken for mm) would make it"),
        ("source.exposure_ms", 0.02, "20 would be 0.02 s"),
    ],
)
def test_a_wrong_unit_is_doubted_with_the_likely_value(key: str, value: float, words: str) -> None:
    (doubt,) = _doubts({key: value})
    assert doubt.startswith(f"{key} is {value:g}")
    assert words in doubt


def test_a_tiny_field_of_view_is_not_blamed_on_the_part() -> None:
    part = {"shape": {"kind": "box", "size_mm": [209, 80, 80]}, "material": "aluminium"}
    (doubt,) = _doubts({"specimen.parts": [part], "detector.pixel_pitch_mm": 0.002})
    assert "the field of view measures 0.16 mm, but specimen and distances about" in doubt


@pytest.mark.parametrize("name", ["balls", "circle_gantry", "demo", "wide_panel"])
def test_no_built_in_scenario_is_doubted(name: str) -> None:
    assert not _doubts({}, name)


def test_a_micro_ct_is_not_doubted() -> None:
    small = {"shape": {"kind": "sphere", "radius_mm": 0.5}, "material": "aluminium"}
    lengths = {"trajectory.sod_mm": 12, "trajectory.sdd_mm": 600, "detector.pixel_pitch_mm": 0.4}
    changes = {"specimen.parts": [small], "reconstruction.grid": {"voxels": 64, "voxel_mm": 0.02}}
    assert not _doubts(lengths | changes)
