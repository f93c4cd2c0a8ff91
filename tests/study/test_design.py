"""From a study to its trials: axes crossed, paired and for some only, ranges, draws, seeds."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
import yaml
from scipy import stats

from twinct.core.errors import InputError
from twinct.study import load_study
from twinct.study.design import Trial

from .conftest import SCENARIO

RELAXATION, ALGORITHM, ITERATIONS = (
    f"reconstruction.{name}" for name in ("relaxation", "algorithm", "iterations")
)
NOISE = ("uncertainty.source.sigma_mm", "uncertainty.detector.sigma_mm")


def values(small, **axis) -> list:
    """Of one axis."""
    design = load_study(small(axes=[{"key": RELAXATION, "label": "x", **axis}]))
    return [trial.axes["x"] for trial in design.trials()]


def draws(small, kind: str, number: int, **keys) -> list[float]:
    return values(small, draw={"kind": kind, "number": number, **keys})


def test_axes_are_crossed_the_last_and_the_seed_change_fastest(small) -> None:
    design = load_study(
        small(
            axes=[
                {"key": RELAXATION, "values": [0.2, 0.5]},
                {"key": list(NOISE), "label": "noise", "values": [0, 0.3]},
            ],
            repetitions={"number": 2, "key": "uncertainty.seed", "first": 5},
        )
    )
    trials = list(design.trials())
    assert [trial.number for trial in trials] == list(range(8))
    assert design.labels == (RELAXATION, "noise")
    told = [(t.axes[RELAXATION], t.axes["noise"], t.seed) for t in trials]
    assert told == [(r, n, s) for r in (0.2, 0.5) for n in (0, 0.3) for s in (5, 6)]
    last = trials[-1]
    assert last.changes == {RELAXATION: 0.5, NOISE[0]: 0.3, NOISE[1]: 0.3, "uncertainty.seed": 6}
    assert str(last) == f"trial 7 ({RELAXATION} = 0.5, noise = 0.3, seed 6)"
    scenario = design.scenario(last)
    assert scenario.uncertainty.detector.sigma_mm == 0.3 and scenario.uncertainty.seed == 6
    assert design.scenario(trials[0]).uncertainty.source.sigma_mm == 0


def test_names_of_values_stand_in_tables(small) -> None:
    paths = {"circle": {"kind": "circle", "views": 8}, "saddle": {"kind": "saddle", "views": 9}}
    design = load_study(small(axes=[{"key": "trajectory", "label": "path", "values": paths}]))
    trials = list(design.trials())
    assert [trial.axes["path"] for trial in trials] == ["circle", "saddle"]
    assert [trial.changes["trajectory"] for trial in trials] == [*paths.values()]
    assert design.scenario(trials[1]).trajectory.views == 9


def test_a_study_of_nothing_has_one_trial(small) -> None:
    (trial,) = load_study(small()).trials()
    assert trial == Trial(0, {}, {}) and str(trial) == "trial 0"


def test_paired_axes_go_on_together(small) -> None:
    parts = [
        {"key": RELAXATION, "values": [0.2, 0.5]},
        {"key": "seed", "label": "s", "values": [1, 2]},
    ]
    design = load_study(small(axes=[{"paired": parts}]))
    assert [dict(t.axes) for t in design.trials()] == [
        {RELAXATION: 0.2, "s": 1},
        {RELAXATION: 0.5, "s": 2},
    ]
    short = [parts[0], {**parts[1], "values": [1]}]
    with pytest.raises(
        InputError, match=rf"axes\.0\.paired: {RELAXATION} has 2, s has 1; they must"
    ):
        load_study(small(axes=[{"paired": short}]))


def only(small, first: list[dict], where: dict) -> list[tuple]:
    axes = [*first, {"key": ITERATIONS, "values": [1, 2], "only": where}]
    found = load_study(small(axes=axes)).trials()
    return [(t.axes.get(ALGORITHM), t.axes[ITERATIONS], ITERATIONS in t.changes) for t in found]


def test_an_axis_for_one_algorithm_only_is_left_alone_elsewhere(small) -> None:
    first = [{"key": ALGORITHM, "values": ["fdk", "sart", "sirt"]}]
    expected = [("fdk", None, False)]
    expected += [(name, n, True) for name in ("sart", "sirt") for n in (1, 2)]
    assert only(small, first, {ALGORITHM: ["sart", "sirt"]}) == expected
    # A key that no axis sets has the scenario's value, or its default.
    assert only(small, [], {ALGORITHM: "sart"}) == [(None, 1, True), (None, 2, True)]
    assert only(small, [], {"reconstruction.nonnegative": True}) == [(None, None, False)]
    # An axis that sets the section around it.
    sections = [{"algorithm": "fdk", "grid": {"voxels": 16, "voxel_mm": 10}}]
    around = [{"key": "reconstruction", "label": ALGORITHM, "values": sections}]
    assert [n for _, n, _ in only(small, around, {ALGORITHM: "sart"})] == [None]


def test_only_over_a_key_that_is_none(written) -> None:
    path = written(f"axes:\n  - {{key: seed, label: s, values: [1], only: {{{ALGORITHM}s: x}}}}")
    with pytest.raises(InputError, match=rf":3: axis s: only: {ALGORITHM}s is not a key of the sc"):
        load_study(path)


def test_ranges(small) -> None:
    def span(**keys) -> list:
        return values(small, range=keys)

    assert span(first=0.1, last=0.5, number=5) == [0.1, 0.2, 0.3, 0.4, 0.5]
    assert span(first=1, last=0.25, number=3, scale="log") == [1, 0.5, 0.25]
    assert span(first=1, last=1, number=1) == [1]
    whole = span(first=1, last=100, number=9, scale="log", whole=True)
    assert whole == [1, 2, 3, 6, 10, 18, 32, 56, 100]
    assert all(type(value) is int for value in whole)
    assert span(first=1, last=3, number=9, whole=True) == [1, 2, 3]


@pytest.mark.parametrize(
    ("kind", "keys", "distribution"),
    [
        ("uniform", {"low": -1, "high": 3}, stats.uniform(-1, 4)),
        ("log_uniform", {"low": 0.1, "high": 10}, stats.loguniform(0.1, 10)),
        ("normal", {"mean": 2, "sigma": 0.5}, stats.norm(2, 0.5)),
    ],
)
def test_draws_are_seeded_and_stay_when_more_are_drawn(small, kind, keys, distribution) -> None:
    drawn = draws(small, kind, 400, **keys)
    assert drawn == draws(small, kind, 400, **keys)
    assert drawn[:7] == draws(small, kind, 7, **keys)
    assert not set(drawn) & set(draws(small, kind, 400, seed=1, **keys))
    assert stats.kstest(drawn, distribution.cdf).pvalue > 0.01


def test_axes_draw_each_on_their_own(small) -> None:
    draw = {"kind": "uniform", "low": 0, "high": 1, "number": 4}
    parts = [{"key": key, "draw": draw} for key in (RELAXATION, NOISE[0])]
    trials = load_study(small(axes=[{"paired": parts}])).trials()
    first, second = np.array([[*t.axes.values()] for t in trials]).T
    assert not np.any(first == second)


def test_files_are_relative_to_the_study(written, tmp_path, monkeypatch) -> None:
    for name in ("a.stl", "b.stl"):
        trimesh.creation.icosphere(radius=50).export(tmp_path / name)
    path = written(
        "set: {specimen.parts.0.shape: {kind: mesh, path: a.stl}}\n"
        "axes:\n  - {key: specimen.parts.0.shape.path, label: file, values: [a.stl, b.stl]}\n"
    )
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    design = load_study(path)
    trials = list(design.trials())
    assert [t.axes["file"] for t in trials] == ["a.stl", "b.stl"]
    found = [design.scenario(t).files()["specimen.parts.0.shape.path"] for t in trials]
    assert found == [tmp_path / "a.stl", tmp_path / "b.stl"]
    (tmp_path / "scenario.yaml").write_text(path.read_text().splitlines()[0].partition(": ")[2])
    path.write_text("scenario: scenario.yaml\nset: {seed: 3}\n")
    assert load_study(path).scenario(Trial(0, {}, {})).seed == 3
    assert load_study(path).text == path.read_text()


def test_set_changes_all_trials_and_an_axis_comes_after_it(small) -> None:
    design = load_study(
        small(set={RELAXATION: 0.7, "seed": 9}, axes=[{"key": RELAXATION, "values": [0.3]}])
    )
    (trial,) = design.trials()
    scenario = design.scenario(trial)
    assert (scenario.reconstruction.relaxation, scenario.seed) == (0.3, 9)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "axes:\n  - {key: seed, values: [1]}",
            ":3: axis seed: a column of the results",
        ),
        (
            "axes:\n  - {key: a, label: seconds.x, values: [1]}",
            ":3: axis seconds.x: a column",
        ),
        (
            "axes:\n  - {key: a, label: x, values: [1]}\n  - {key: b, label: x, values: [1]}",
            ":4: axis x: another axis has this name",
        ),
        (
            "axes:\n  - {key: a, label: x, values: [1]}\n  - {key: [b, a], label: y, values: [1]}",
            ":4: axis y: a is varied twice",
        ),
        (
            "axes: [{key: motion.b, values: [1]}]\nrepetitions: {number: 2, key: motion.b}",
            ":3: repetitions: motion.b is varied twice",
        ),
        (
            "max_trials: 9\naxes: [{key: a, range: {first: 0, last: 1, number: 1000000000000}}]",
            ":2: more than 9 trials .max_trials.: a has 1000000000000",
        ),
        (
            "repetitions: {number: 1000000000000}",
            ":2: more than 10000 trials .max_trials.: repetitions",
        ),
        ("set:\n  seed.x: 1", ":3: seed: must be a whole number, but is"),
    ],
)
def test_what_does_not_go_together_is_one_message(written, text: str, said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        design = load_study(written(text))
        design.scenario(next(iter(design.trials())))
    assert len(caught.value.problems) == 1


def test_problems_of_a_scenario_in_the_study_name_its_line(tmp_path) -> None:
    path = tmp_path / "study.yaml"
    path.write_text("scenario:\n  cell: {kind: gantri}\n")
    design = load_study(path)
    with pytest.raises(InputError) as caught:
        design.scenario(Trial(0, {}, {}))
    assert any(problem.startswith(f"{path}:2: cell.kind") for problem in caught.value.problems)


def test_plain_data_may_hold_paths(tmp_path) -> None:
    (tmp_path / "scenario.yaml").write_text("seed: 4\n")
    design = load_study({"scenario": tmp_path / "scenario.yaml"})
    assert design.template.data == {"seed": 4}


def test_an_inline_scenario_extends_a_file_beside_the_study(tmp_path) -> None:
    (tmp_path / "base.yaml").write_text(yaml.safe_dump(SCENARIO))
    (tmp_path / "study.yaml").write_text(
        "scenario: {extends: base.yaml, seed: 5}\n"
        "axes: [{key: reconstruction.relaxation, values: [0.1, 0.2]}]\n"
    )
    design = load_study(tmp_path / "study.yaml")
    scenario = design.scenario(next(iter(design.trials())))
    assert (scenario.seed, scenario.trajectory.kind) == (5, "circle")
