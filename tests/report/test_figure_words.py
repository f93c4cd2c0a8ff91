"""Words and better values of figures, against a list recorded before kinds declared them."""

import json
from pathlib import Path

import pytest

from twinct.evaluation import IMAGE_FIGURES, figure_kinds
from twinct.evaluation.figure import BADNESS
from twinct.report.figure_words import axis_words, figure_words

RECORDED = json.loads(Path(__file__).with_name("figure_words.json").read_text())


@pytest.mark.parametrize("name", RECORDED)
def test_words_are_those_of_the_record(name):
    shown = figure_words(name, "steel")
    told = [shown.title, shown.unit, shown.factor, shown.digits, shown.meaning, shown.best]
    assert told == RECORDED[name]
    assert shown.key == name


def test_the_record_has_all_figures_of_volumes():
    asked = {
        f"image.{kind.name}.{name.split('.')[2]}.{one.key}"
        for kind in figure_kinds().values()
        for one in kind.figures
        for name in RECORDED
        if name.startswith(f"image.{kind.name}.")
    }
    assert asked and asked <= {*RECORDED}
    assert {f"image.{one.key}" for one in IMAGE_FIGURES} <= {*RECORDED}


def test_the_name_of_a_region_decides_nothing():
    assert figure_words("image.regions.error_zone.mean_rel").best == ""
    assert figure_words("image.nps.noise_box.mean_frequency_per_mm").best == ""
    assert figure_words("image.regions.psnr.rmse_rel").best == "lower"


@pytest.mark.parametrize(("best", "order"), [("lower", [0, 1, 3]), ("higher", [3, 1, 0])])
def test_badness_is_lower_for_better_values(best, order):
    assert sorted([1, 3, 0], key=BADNESS[best]) == order
    assert sorted([3, 0.9, 0], key=BADNESS["one"]) == [0.9, 0, 3]
    assert BADNESS[""](7) == BADNESS[""](-7)


def test_axes_of_a_study_are_named_by_their_keys():
    sigma = ("uncertainty.source.sigma_mm", "uncertainty.detector.sigma_mm")
    parts = [(f"specimen.parts.{part}.material",) for part in (0, 1)]
    axes = [("reconstruction.iterations",), sigma, ("source.current_ma",), *parts]
    assert axis_words(axes) == [
        ("iterations", ""),
        ("sigma", "mm"),
        ("current", "mA"),
        ("0 material", ""),
        ("1 material", ""),
    ]
