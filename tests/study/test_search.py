"""What a search asks for: always the same after the same, and soon near the best."""

from __future__ import annotations

import math

import numpy as np
import pytest

from twinct.study.search import Tried, next_values, trial_of
from twinct.study.settings import Search


def search(*keys: dict, **more: object) -> Search:
    told = {"figure": "image.rmse_rel", "trials": 40, "keys": keys, **more}
    return Search.model_validate(told)


X, Y = ({"key": f"motion.{name}", "label": name, "low": -1, "high": 2} for name in "xy")


def bowl(values) -> float:
    return (values["x"] - 0.3) ** 2 + (values["y"] + 0.2) ** 2


def searched(what: Search, judge=bowl) -> list[Tried]:
    tried: list[Tried] = []
    while len(tried) < what.trials:
        tried += [(values, judge(values)) for values in next_values(what, tried)]
    return tried


def test_the_same_is_asked_after_the_same() -> None:
    what = search(X, Y, trials=10)
    tried = searched(what)
    assert len(tried) == 10
    for number in (0, 4, 8):  # a new process, which knows what was told alone
        asked_again = next_values(what, tried[:number])
        assert asked_again == [values for values, _ in tried[number : number + 4]]
    assert len(next_values(what, tried[:8])) == 2 and next_values(what, tried) == []
    longer = search(X, Y, trials=12)
    assert next_values(longer, tried[:8])[:2] == [values for values, _ in tried[8:]]


def test_batches_and_seeds_are_told_apart() -> None:
    first = next_values(search(X, Y, seed=0), [])
    assert next_values(search(X, Y, seed=1), []) != first
    failed: list[Tried] = [(values, None) for values in first]
    second = next_values(search(X, Y, seed=0), failed)
    assert not {v["x"] for v in first} & {v["x"] for v in second}
    assert len({v["x"] for v in first}) == len(first) == 4


def test_values_are_of_their_kind_and_within_their_ends() -> None:
    keys = [
        {"key": "a", "low": 0.01, "high": 100, "scale": "log"},
        {"key": "b", "low": 1, "high": 4, "whole": True},
        {"key": "c", "choices": ["fdk", 3, True]},
        {"key": ["d", "e"], "low": 0, "high": 1},
    ]
    what = search(*keys, trials=200, batch=200)
    values = next_values(what, [])
    a = np.array([v["a"] for v in values])
    assert 0.01 <= a.min() < a.max() <= 100
    assert 0.35 < np.mean(a < 1) < 0.65  # half of the logarithms
    assert {v["b"] for v in values} == {1, 2, 3, 4}
    assert all(type(v["b"]) is int for v in values)
    assert {str(v["c"]) for v in values} == {"fdk", "3", "True"}
    choice = trial_of(what, values[0])
    assert set(choice.changes) == {"a", "b", "c", "d", "e"}
    assert choice.changes["d"] == choice.changes["e"] == choice.axes["d, e"]


@pytest.mark.parametrize(("direction", "sign"), [("minimize", 1), ("maximize", -1)])
def test_it_comes_nearer_to_the_best_than_chance(direction: str, sign: int) -> None:
    what = search(X, Y, trials=48, direction=direction)
    found = sorted(sign * figure for _, figure in searched(what, lambda v: sign * bowl(v)))
    rng = np.random.default_rng(3)
    chance = [
        sorted(bowl(dict(zip("xy", rng.uniform(-1, 2, 2), strict=True))) for _ in range(48))
        for _ in range(200)
    ]
    # The tenth best: better than in 19 of 20 searches by chance.
    assert found[9] < np.quantile([one[9] for one in chance], 0.05)


def test_what_fails_is_kept_away_from_nobody_else() -> None:
    def judge(values) -> float | None:
        return None if values["x"] < 0 else bowl(values)

    tried = searched(search(X, Y, trials=40), judge)
    best = min(figure for _, figure in tried if figure is not None)
    assert any(figure is None for _, figure in tried) and best < 0.1
    assert all(math.isfinite(values["x"]) for values, _ in tried)
