"""Kinds of figures: what a kind refuses, and what it makes of the numbers of its formula."""

import math

import numpy as np
import pytest

from twinct.evaluation import Figure, FigureKind, FigureSettings, Measurement


class Entry(FigureSettings):
    part: str
    region: str = "all"


def kind(measure=lambda at, one: {}, **changes):
    figures = Figure("a", "A"), Figure("b", "B")
    given = {"name": "mine", "settings": Entry, "description": "Mine.", "figures": figures}
    return FigureKind(**given | {"measure": measure} | changes)


AT = Measurement(None, np.zeros((1, 1, 1)), np.zeros((1, 1, 1)), 1.0)


def test_the_first_key_names_the_figures_without_dots():
    assert Entry(part="ball.1").label == "ball_1"


def test_a_figure_that_is_left_out_is_nan_and_curves_come_last():
    found = kind(lambda at, one: {"curve": [1, 2], "b": np.float32(0.5)}).measured(AT, None)
    assert list(found) == ["a", "b", "curve"]
    assert math.isnan(found["a"]) and type(found["b"]) is float and found["curve"] == [1, 2]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"name": "a.b"}, "'a.b' must be lower-case"),
        ({"names": {"regions": "region"}}, "Entry has no key regions"),
    ],
)
def test_a_kind_that_no_scenario_could_use_is_refused(changes, said):
    with pytest.raises(ValueError, match=said):
        kind(**changes)


def test_what_several_entries_need_is_computed_once():
    calls = []

    def length(at, name):
        calls.append(name)
        return len(name)

    at = Measurement(None, AT.volume, AT.truth, 1.0)
    assert [at.once(length, name) for name in ("x", "yy", "x")] == [1, 2, 1]
    assert calls == ["x", "yy"]
