"""The section of errors: presets, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from twinct.core.errors import ScenarioError
from twinct.scenario import PRESETS, Uncertainty, load_scenario, parse_scenario, stage_digests

SCENARIOS = Path(__file__).parents[2] / "scenarios"


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_gives_way_to_what_is_said(name: str) -> None:
    plain = Uncertainty.model_validate({"preset": name})
    assert plain.moves
    assert Uncertainty.model_validate(plain.model_dump()) == plain  # its values are valid ones
    assert Uncertainty.model_validate(PRESETS[name]).arms == plain.arms
    own = {"preset": name, "views": {"source_mm": 0.7}}
    found = Uncertainty.model_validate(own)
    assert found.views.source_mm == 0.7
    assert found.arms == plain.arms
    assert found.views.detector_tilt_deg == plain.views.detector_tilt_deg > 0


def test_a_preset_is_its_keys() -> None:
    scenario = load_scenario(SCENARIOS / "demo.yaml", ["uncertainty.preset=collaborative"])
    again = parse_scenario(json.loads(scenario.resolved()))
    assert again == scenario
    told = json.loads(scenario.resolved())
    told["uncertainty"]["preset"] = None
    assert stage_digests(parse_scenario(told)) == stage_digests(scenario)


@pytest.mark.parametrize(
    ("file", "keys", "words"),
    [
        (
            "circle_gantry.yaml",
            ["uncertainty.arms.tool_mm=0.1"],
            "uncertainty.arms: a gantry has no arms; uncertainty.views applies to any machine",
        ),
        ("circle_gantry.yaml", ["uncertainty.preset=industrial"], "a gantry has no arms"),
        ("demo.yaml", ["uncertainty.preset=robot"], "must be 'industrial'"),
        ("demo.yaml", ["uncertainty.views.source_mm=-1"], "uncertainty.views.source_mm"),
        (
            "demo.yaml",
            ["uncertainty.source.correlation_views=4"],
            "correlation_views above 0 needs cutoff_mm: null",
        ),
        ("demo.yaml", ["uncertainty.arms.tool=1"], "did you mean"),
    ],
)
def test_what_cannot_be_is_refused(file: str, keys: list[str], words: str) -> None:
    with pytest.raises(ScenarioError, match=words):
        load_scenario(SCENARIOS / file, keys)
