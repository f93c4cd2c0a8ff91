"""What a study file may say, section by section; each problem is one message with its line."""

from __future__ import annotations

import re

import pytest

from twinct.core.errors import InputError
from twinct.study import load_study
from twinct.study.settings import Study

KEY = "key: reconstruction.relaxation"


def search(key: str) -> str:
    return f"search: {{figure: image.ssim, trials: 3, keys: [{key}]}}"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("axis: []", "2: axis: unknown key; did you mean 'axes'?"),
        ("axes: {seed: [1]}", "2: axes: must be a list, but is"),
        ("axes: [seed]", "2: axes.0: must be a section of keys and values, but is 'seed'"),
        ("axes:\n  - {key: a, value: [1]}", "3: axes.0.value: unknown key; did you mean 'values'"),
        (f"axes:\n  - {{{KEY}, values: []}}", "3: axes.0.values: must have at least 1 entry, but"),
        (f"axes:\n  - {{{KEY}}}", "3: axes.0: one of values, range, draw and paired is needed; no"),
        (
            f"axes:\n  - {{{KEY}, values: [1], range: {{first: 1, last: 2, number: 2}}}}",
            "3: axes.0: one of values, range, draw and paired is needed; values and range are gi",
        ),
        ("axes:\n  - {values: [1]}", "3: axes.0: an axis needs either a key or paired axes"),
        ("axes: [{key: '', values: [1]}]", "2: axes.0.key: '' is not a dotted key such as"),
        ("axes: [{key: A b, values: [1]}]", "2: axes.0.key: 'A b' is not a dotted key such as"),
        (
            "axes:\n  - paired:\n    - {key: a, values: [1]}",
            "4: axes.0.paired: must have at least 2 entries, but has 1",
        ),
        (
            "axes:\n- paired:\n  - {key: a, values: [1]}\n  - {key: b, values: [1], only: {c: 2}}",
            "4: axes.0: paired axes take a key and values, but no 'paired' or 'only'",
        ),
        (
            f"axes: [{{{KEY}, range: {{first: 0, last: 1, number: 3, scale: log}}}}]",
            "2: axes.0.range: a log scale needs numbers above 0, not 0 to 1",
        ),
        (
            f"axes: [{{{KEY}, range: {{first: .nan, last: 1, number: 3}}}}]",
            "2: axes.0.range.first: must be a finite number, but is nan",
        ),
        (
            f"axes: [{{{KEY}, range: {{first: 0, last: 1, number: 0}}}}]",
            "2: axes.0.range.number: must be greater than or equal to 1, but is 0",
        ),
        (
            f"axes: [{{{KEY}, draw: {{kind: gamma, number: 3}}}}]",
            "2: axes.0.draw.kind: kind 'gamma' is not one of 'uniform', 'log_uniform', 'normal'",
        ),
        (
            f"axes: [{{{KEY}, draw: {{kind: uniform, low: 2, high: 1, number: 3}}}}]",
            "2: axes.0.draw: nothing lies between low 2 and high 1",
        ),
        (
            f"axes: [{{{KEY}, draw: {{kind: normal, mean: 2, sigma: -1, number: 3}}}}]",
            "2: axes.0.draw.sigma: must be greater than or equal to 0, but is -1",
        ),
        (
            search("{key: a, low: 1}"),
            "2: search.keys.0: either low and high, or choices, are needed",
        ),
        (
            search("{key: a, low: 1, high: 2, choices: [1]}"),
            "2: search.keys.0: either low and high, or choices, are needed",
        ),
        (
            search("{key: a, low: 2, high: 1}"),
            "2: search.keys.0: 2 to 1 is not a valid linear range",
        ),
        (
            search("{key: a, low: 0, high: 1, scale: log}"),
            "2: search.keys.0: 0 to 1 is not a valid log range",
        ),
        (
            search("{key: a, low: 0.4, high: 3, whole: true}"),
            "2: search.keys.0: whole: low 0.4 and high 3 must be whole numbers",
        ),
        (
            f"axes: [{{{KEY}, values: [1]}}]\n{search('{key: a, low: 0, high: 1}')}",
            "3: a study has axes or a search, not both",
        ),
        ("keep: all", "2: keep: must be 'figures', 'volume' or 'everything', but is 'all'"),
        ("repetitions: {number: 0}", "2: repetitions.number: must be greater than or equal to 1"),
        ("figures: []", "2: figures: must have at least 1 entry, but has 0"),
        ("max_trials: 0", "2: max_trials: must be greater than or equal to 1, but is 0"),
        ("axes: []\naxes: []", "3: the key 'axes' appears twice"),
    ],
)
def test_a_problem_is_one_message_with_its_line(written, text: str, said: str) -> None:
    path = written(text)
    with pytest.raises(InputError) as caught:
        load_study(path)
    (problem,) = caught.value.problems
    assert re.match(f"{re.escape(str(path))}:{re.escape(said)}", problem), problem


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "the study is empty"),
        ("3", "a study must be a mapping"),
        ("a: [", ":1: not valid YAML"),
        ("axes: []", ":1: scenario: this required key is missing"),
        ("name: x\nscenario: none.yaml", ":2: scenario: no file at .*none.yaml"),
        (
            "name: x\nscenario: 3",
            ":2: scenario: must be text or a mapping of .*, but is 3",
        ),
    ],
)
def test_no_study_is_one_message(tmp_path, text: str, said: str) -> None:
    (tmp_path / "study.yaml").write_text(text)
    with pytest.raises(InputError, match=f"study.yaml:? ?{said}") as caught:
        load_study(tmp_path / "study.yaml")
    assert len(caught.value.problems) == 1
    with pytest.raises(InputError, match=r"none\.yaml: the study does not exist"):
        load_study(tmp_path / "none.yaml")


def test_what_is_left_out_has_these_values() -> None:
    study = Study.model_validate({"scenario": {}})
    assert (study.axes, study.search, study.repetitions) == ((), None, None)
    assert (study.keep, study.link, study.threads, study.max_trials) == (
        *("figures", "local"),
        *(1, 10_000),
    )


def test_every_key_says_what_it_is_for() -> None:
    sections, seen = [Study.model_json_schema()], 0
    for section in [*sections, *sections[0]["$defs"].values()]:
        for name, told in section.get("properties", {}).items():
            seen += 1
            assert told.get("description"), name
    assert seen > 40
