"""All trials are looked at before the first starts; what they share is known by digests."""

from __future__ import annotations

import re
from dataclasses import replace

import pytest

from twinct.core.errors import InputError
from twinct.study import Trial, dry_run, load_study
from twinct.study.checking import MOST_PROBLEMS, Checker

RELAXATION = "reconstruction.relaxation"
NOISE = ("uncertainty.source.sigma_mm", "uncertainty.detector.sigma_mm")


def checked(source) -> list[Trial]:
    design = load_study(source)
    return Checker(design).checked(design.trials())


def axis(key: str, *values: object, **more: object) -> dict:
    return {"key": key, "values": list(values), **more}


def problems(source) -> tuple[str, ...]:
    with pytest.raises(InputError) as caught:
        dry_run(source)
    return caught.value.problems


def test_trials_that_differ_in_reconstruction_or_belief_share_one_scan(small) -> None:
    again = {"number": 2, "key": "uncertainty.seed"}
    axes = [axis(RELAXATION, 0.2, 0.5), {"key": list(NOISE), "values": [0, 0.3]}]
    found = checked(small(axes=axes, repetitions=again))
    assert len({one.scan for one in found}) == 1
    assert len({one.key for one in found}) == 8
    # Without noise no seed is drawn with: the volume is the same.
    assert len({one.volume for one in found}) == 6
    found = checked(small(axes=[axis("source.current_ma", 10, 20), axis(RELAXATION, 0.2, 0.5)]))
    assert [one.scan == found[0].scan for one in found] == [True, True, False, False]
    assert len({one.volume for one in found}) == 4


def test_trials_that_measure_other_things_share_no_figures_but_a_scan(small) -> None:
    region = {"name": "a", "shape": {"kind": "sphere", "radius_mm": 30}}
    study = small(
        axes=[axis("evaluation.regions.0.shape.radius_mm", 20, 30)],
        figures=["image.edge_width_mm", "image.regions.a.mean_rel", "image.zero.ssim"],
    )
    study["scenario"] = study["scenario"] | {"evaluation": {"regions": [region]}}
    found = checked(study)
    assert len({one.scan for one in found}) == 1 and len({one.volume for one in found}) == 2
    study["figures"] = ["image.regions.b.mean_rel"]
    assert any("image.regions.b.mean_rel" in problem for problem in problems(study))


def test_a_trial_has_one_key_whatever_its_number(small) -> None:
    first = checked(small(axes=[axis(RELAXATION, 0.2, 0.5)]))
    before = {one.axes[RELAXATION]: one.key for one in first}
    more = checked(small(axes=[axis(RELAXATION, 0.7, 0.5, 0.2)]))
    assert {one.axes[RELAXATION]: one.key for one in more}.items() > before.items()
    named = checked(small(axes=[axis(RELAXATION, 0.2, 0.5, label="other words")], name="n"))
    assert [one.key for one in named] == list(before.values())


def test_trials_of_one_kind_take_alike(small) -> None:
    def costs(*axes: dict, **keys: object) -> list:
        return [one.cost for one in checked(small(axes=axes, **keys))]

    relaxations = costs(axis(RELAXATION, 0.2, 0.5))
    assert relaxations[0] is relaxations[1]
    for other in (axis("trajectory.views", 4, 6), axis("detector.columns", 24, 30)):
        few, more = costs(other)
        assert few.scan != more.scan and few.rest != more.rest
    few, more = costs(axis("reconstruction.iterations", 1, 3))
    assert few.scan == more.scan and few.rest != more.rest
    assert costs(keep="volume")[0].rest != costs()[0].rest
    assert costs(threads=2)[0].scan != costs()[0].scan
    assert 0 < few.scan_bytes < few.memory_bytes and few.volume_bytes == 4 * 16**3


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "axes:\n  - {key: reconstruction.relaxatoin, values: [1]}",
            r":3: axis reconstruction.relaxatoin: .*did you mean 'relaxation'\?.*in trial 0 \(",
        ),
        ("axes:\n  - {key: nothing.there, values: [1]}", ":3: axis nothing.there: nothing: unk"),
        (
            "axes:\n  - {key: specimen.parts.3.density, values: [1]}",
            ":3: .*'3' is not a valid index",
        ),
        ("axes:\n  - {key: source.current_ma.x, values: [1]}", ":3: .*source.current_ma"),
        (
            "axes:\n  - {key: reconstruction.relaxation, values: [0.5, -3, 0.2]}",
            r":3: .*must be above 0 and below 2, but is -3; in trial 1 \(.*relaxation = -3\)",
        ),
        (
            "axes:\n  - {key: uncertainty.seed, values: [1, 1.5]}",
            ":3: .*must be a whole number, but is 1.5",
        ),
        (
            "axes:\n  - {key: specimen.parts.0.shape, values: [{kind: mesh, path: none.stl}]}",
            ":3: .*specimen.parts.0.shape.path: no file at .*none.stl; in trial 0",
        ),
        (  # each value is good, both together are not
            "axes:\n  - {key: reconstruction.algorithm, values: [sart, fdk]}\n"
            "  - {key: reconstruction.relaxation, values: [0.5]}",
            r":4: axis reconstruction.relaxation: .*relaxation.*in trial 1 \(.*algorithm = fdk",
        ),
        (
            "axes: [{key: specimen.parts.0.material, values: [bone, unobtainium]}]",
            ":2: axis specimen.parts.0.material: .*unknown material 'unobtainium'.*; in trial 1",
        ),
        ("repetitions: {number: 2, key: uncertainty.sead}", ":2: repetitions: uncertainty.sead: "),
        ("set: {detector.columns: -1}", ":2: detector.columns: must be at least 1"),
        ("figures: [image.rmse]", "figure 'image.rmse': no trial has it; did you mean"),
        (
            "search: {figure: image.rms, trials: 1, keys: [{key: seed, choices: [1], label: s}]}",
            "figure 'image.rms': no trial has it",
        ),
        (
            "axes: [{key: uncertainty.seed, values: [1, 2, 1]}]",
            r":2: trial 0 \(uncertainty.seed = 1\) and trial 2 \(uncertainty.seed = 1\) are",
        ),
        (
            "axes: [{key: uncertainty.seed, label: views, values: [1]}]",
            "axis views: a figure has this name",
        ),
        (
            "max_trials: 5\naxes: [{key: uncertainty.seed, values: [1, 2]}]\n"
            "repetitions: {number: 3}",
            r":2: the study has more than 5 trials \(max_trials\)",
        ),
        (
            "max_trials: 5\nsearch: {figure: image.ssim, trials: 3, "
            "keys: [{key: seed, label: s, choices: [1]}]}\nrepetitions: {number: 2, key: motion.s}",
            r":2: the search has 6 trials, more than max_trials 5",
        ),
    ],
)
def test_what_no_trial_may_have_is_told_before_any_starts(written, text: str, said: str) -> None:
    (problem,) = problems(written(text))
    assert re.search(said, problem), problem


def test_of_many_problems_the_first_are_told(small) -> None:
    bad = [-value for value in range(1, 100)]
    *told, last = problems(small(axes=[axis(RELAXATION, 0.5, *bad)]))
    assert len(told) == MOST_PROBLEMS and last == "further trials were not checked"


def test_a_figure_that_some_trials_have_is_one(small) -> None:
    axes = [axis("reconstruction.geometry", "executed", ["executed", "believed"])]
    figure = "image_by_geometry.believed.ssim"
    key = "reconstruction.geometry"
    assert len(checked(small(figures=[figure], axes=axes))) == 2
    assert figure in problems(small(figures=[figure], axes=[axis(key, "executed")]))[0]


def test_progress_hears_of_each_trial(small) -> None:
    from twinct.observers import audience_of

    heard: list[object] = []
    design = load_study(small(axes=[axis(RELAXATION, 0.2, 0.5, 0.7)]))
    with audience_of([heard.append]) as audience:
        Checker(design).checked(design.trials(), audience)
    assert heard


def test_a_dry_run_leaves_out_what_is_there_and_writes_nothing(small, tmp_path) -> None:
    found = dry_run(small(axes=[axis(RELAXATION, 0.2, 0.5)]), tmp_path / "out")
    assert [trial.axes[RELAXATION] for trial in found.trials] == [0.2, 0.5]
    assert (found.there, found.estimate.trials, found.estimate.scans) == (0, 2, 1)
    assert found.estimate.seconds is None and not found.estimate.measured
    assert not (tmp_path / "out").exists()


def test_one_trial_alone_is_the_same(small) -> None:
    design = load_study(small(axes=[axis(RELAXATION, 0.2, 0.5)]))
    checker, trials = Checker(design), list(design.trials())
    together = checker.checked(trials)
    assert [checker.one(trial) for trial in trials] == together
    other = replace(trials[0], number=7)
    assert checker.one(other).key == together[0].key
