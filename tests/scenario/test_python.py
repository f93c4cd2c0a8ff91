"""Scenarios made and changed in Python: mappings instead of files and texts."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from twinct.core.errors import ScenarioError
from twinct.scenario import load_scenario, loading, parse_scenario

DEMO = Path(__file__).parents[2] / "scenarios" / "demo.yaml"


def test_overrides_are_values_by_dotted_key() -> None:
    changes = {
        "trajectory.views": 12,
        "detector": {"columns": 40, "rows": 30, "pixel_pitch_mm": 8},
        "specimen.position_mm": np.array([1.0, 2.0, 3.0]),
        "specimen.parts.0.material": "water",
    }
    texts = [
        "trajectory.views=12",
        "detector={columns: 40, rows: 30, pixel_pitch_mm: 8}",
        "specimen.position_mm=[1, 2, 3]",
        "specimen.parts.0.material=water",
    ]
    assert load_scenario(DEMO, changes) == load_scenario(DEMO, texts)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"trajectory.views": 0}, r"^trajectory\.views: .*at least 1.*0"),
        ({"detector.colums": 3}, r"^detector\.colums: .*did you mean 'columns'"),
        ({"specimen.parts.7.material": "water"}, r"^specimen\.parts\.7\.material: .* a list of"),
        ({"name.first": "x"}, r"^name\.first: name is a value"),
        ({"trajectory..views": 3}, r"^'trajectory\.\.views': expected a dotted key"),
    ],
)
def test_messages_name_the_key_and_no_option(changes, said: str) -> None:
    with pytest.raises(ScenarioError, match=said) as told:
        load_scenario(DEMO, changes)
    assert "--set" not in str(told.value)


def test_a_scenario_is_changed_into_another() -> None:
    demo = load_scenario(DEMO)
    other = demo.with_({"trajectory.views": 12}, seed=7)
    assert other == load_scenario(DEMO, ["trajectory.views=12", "seed=7"])
    assert demo == load_scenario(DEMO), "and stays as it is"
    circle = demo.with_({"trajectory.kind": "circle", "trajectory.views": 5})
    assert circle.trajectory.kind == "circle"
    assert demo.with_({"reconstruction.algorithm": "fdk"}).reconstruction.algorithm == "fdk"
    with pytest.raises(ScenarioError, match=r"^trajectory\.views: "):
        demo.with_({"trajectory.views": -1})


def test_a_key_that_does_not_apply_is_logged_once_and_only_if_somebody_chose_it(
    caplog: pytest.LogCaptureFixture,
) -> None:
    loading._warn_once.cache_clear()
    demo = load_scenario(DEMO)
    mine = demo.with_({"reconstruction.relaxation": 0.123})
    for scenario in (demo, mine, mine, demo):
        scenario.with_({"reconstruction.algorithm": "fdk"}, seed=7)
    said = [record.getMessage() for record in caplog.records]
    ignored = "reconstruction.relaxation does not apply to fdk and is ignored"
    assert [text for text in said if "relaxation" in text] == [ignored]
    assert len(said) == len(set(said))
    assert not any("nonnegative" in text for text in said)


def test_a_mapping_extends_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mine = {"extends": str(DEMO), "trajectory": {"views": 12}}
    own = {"trajectory.views": 12, "description": ""}  # DEMO's describes DEMO
    assert load_scenario(mine) == load_scenario(DEMO, own)
    assert load_scenario({**mine, "extends": DEMO}) == load_scenario(mine)
    monkeypatch.chdir(DEMO.parent)
    assert load_scenario({**mine, "extends": "demo.yaml"}) == load_scenario(mine)
    assert mine == {"extends": str(DEMO), "trajectory": {"views": 12}}
    with pytest.raises(ScenarioError, match=r"^extends: no file at none\.yaml"):
        load_scenario({"extends": "none.yaml"})


def test_stored_data_build_on_no_file() -> None:
    """A scan store that somebody sends must not decide which files are read."""
    with pytest.raises(ScenarioError, match="extends"):
        parse_scenario({"extends": str(DEMO)})


def test_a_scenario_is_shown_in_one_line() -> None:
    said = repr(load_scenario(DEMO))
    assert said == str(load_scenario(DEMO))
    assert said.startswith("Scenario('") and "100 views" in said and len(said) < 120


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (
            ["trajectory.kind=circle", "trajectory.views=9", "trajectory.sod_mm=300"],
            "--set trajectory.kind=circle: a new kind starts afresh, without the former sdd_mm, "
            "centre_longitude_deg, longitude_range_deg, latitude_amplitude_deg, periods; set what "
            "you need with it, such as --set trajectory.sdd_mm=...",
        ),
        (["trajectory.kind=sinusoid"], ""),
        (["trajectory.kind=circle", "trajectory={kind: circle, views: 9}"], ""),
        ({"trajectory.kind": "circle", "trajectory.views": 9}, ""),
    ],
)
def test_a_new_kind_says_what_it_leaves_out(
    overrides: Any, said: str, caplog: pytest.LogCaptureFixture
) -> None:
    loading._warn_once.cache_clear()
    with contextlib.suppress(ScenarioError):  # sdd_mm is missing
        load_scenario(DEMO, overrides)
    assert [one.getMessage() for one in caplog.records] == ([said] if said else [])
