"""Built-in scenarios are found by name, where a file of that name is not."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from twinct.cli import run_command
from twinct.core.errors import InputError, ScenarioError
from twinct.scenario import load_scenario, scenario_names
from twinct.study.design import load_study

SCENARIOS = Path(__file__).parents[2] / "scenarios"


def test_every_scenario_of_the_repository_has_a_name() -> None:
    assert set(scenario_names()) == {file.stem for file in SCENARIOS.glob("*.yaml")}
    assert load_scenario("demo", ["seed=4"]) == load_scenario(SCENARIOS / "demo.yaml", {"seed": 4})


def test_a_scenario_extends_a_built_in_one(tmp_path: Path) -> None:
    mine = tmp_path / "mine.yaml"
    mine.write_text("extends: demo\ntrajectory: {views: 7}\n")
    own = {"trajectory.views": 7, "description": ""}
    assert load_scenario(mine) == load_scenario("demo", own)
    assert load_scenario({"extends": "demo"}) == load_scenario("demo")
    mine.write_text("extends: dmeo\n")
    with pytest.raises(ScenarioError, match=r"mine.yaml:1: extends: 'dmeo' .* did you mean 'demo'"):
        load_scenario(mine)


def test_a_file_comes_before_a_built_in_scenario_and_a_folder_does_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "demo").mkdir()
    assert load_scenario("demo") == load_scenario(SCENARIOS / "demo.yaml")
    (tmp_path / "demo").rmdir()
    (tmp_path / "demo").write_text("extends: paper\nseed: 77\n")
    assert load_scenario("demo").seed == 77


@pytest.mark.parametrize("command", ["check", "run", "reach", "urdf", "motion", "specimen", "view"])
def test_an_unknown_name_lists_the_known_ones(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    needed = {
        "run": ["--out", str(tmp_path / "x")],
        "urdf": ["--out", str(tmp_path / "x")],
        "specimen": ["--out", str(tmp_path / "x")],
        "reach": ["--out", str(tmp_path / "x")],
        "motion": ["--out", str(tmp_path / "x"), "--to", "csv"],
    }
    assert run_command([command, "hed", *needed.get(command, ())]) == 2
    said = capsys.readouterr().err
    assert "'hed' is neither a scenario file nor a built-in scenario" in said
    assert "did you mean 'head'?" in said and "circle_gantry, demo" in said


def test_the_path_of_the_repository_leads_to_the_name(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="does not exist; the built-in .* is called demo"):
        load_scenario(tmp_path / "scenarios" / "demo.yaml")
    (tmp_path / "mine.yaml").write_text("extends: paper.yaml\n")
    with pytest.raises(ScenarioError, match="no file at .*paper.yaml; the built-in .* paper"):
        load_scenario(tmp_path / "mine.yaml")


def test_a_study_names_a_built_in_scenario(tmp_path: Path) -> None:
    study = tmp_path / "study.yaml"
    axis = "axes: [{key: source.energy_kev, values: [60, 80]}]\n"
    for scenario in ("demo", "{extends: demo}"):
        study.write_text(f"scenario: {scenario}\n{axis}")
        assert load_study(study).template.data["name"] == "demo"
    for scenario, said in {
        "dmo": r"study.yaml:1: scenario: 'dmo' is neither .* did you mean 'demo'",
        "demo.yaml": r"no file at .*demo.yaml; the built-in scenario is called demo",
    }.items():
        study.write_text(f"scenario: {scenario}\n{axis}")
        with pytest.raises(InputError, match=re.compile(said)):
            load_study(study)
