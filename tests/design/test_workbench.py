"""The model of the workbench, without a browser."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from waiting import HANG_S

from twinct.design.desk import State
from twinct.design.draft import Draft
from twinct.design.questions import SmallVolume
from twinct.design.workbench import Workbench

pytestmark = pytest.mark.process


@pytest.fixture
def bench(small_file: Path, tmp_path: Path) -> Iterator[Workbench]:
    with closing(Workbench(Draft.open(small_file), tmp_path / "workers")) as made:
        made.begin()
        assert made.settle(HANG_S)
        yield made


def price(bench: Workbench, name: str) -> tuple[float, float]:
    found = next(one for one in bench.prices() if one.name == name)
    return found.now, found.saved


def test_answers_follow_the_draft(bench: Workbench, small_file: Path) -> None:
    for subject in ("image", "costs", "views", "sphere", "motion"):
        assert bench.answer(subject).state is State.FRESH, bench.answer(subject)
    time_s, saved_s = price(bench, "motion time")
    assert time_s == saved_s > 1
    first = bench.answer("image").value

    bench.set({"trajectory.views": 6, "trajectory.longitude_range_deg": 180})
    assert bench.settle(HANG_S)
    now_s, saved_s = price(bench, "motion time")
    assert now_s != time_s and saved_s == time_s
    assert price(bench, "views") == (6, 12)
    assert not np.array_equal(bench.answer("image").value, first)
    sphere = bench.answer("sphere")  # reads no views, and was not asked again
    assert sphere.question is not None and sphere.question.source.text != bench.draft.text

    bench.set({"cell.source_arm.base_position_mm": [2500, 0, 0]})
    assert bench.settle(HANG_S)
    assert not bench.answer("views").value.any()
    assert bench.answer("motion").value.plan is None and bench.answer("motion").value.problems
    assert math.isnan(price(bench, "motion time")[0])

    bench.undo()
    bench.save()
    assert bench.settle(HANG_S)
    assert price(bench, "motion time") == (now_s, now_s)
    assert price(bench, "views") == (6, 6)
    assert "views: 6" in small_file.read_text(encoding="utf-8")
    assert small_file.read_text(encoding="utf-8").count("# few") == 1


def test_an_invalid_draft_keeps_old_answers(bench: Workbench) -> None:
    bench.set({"trajectory.views": -1})
    assert bench.settle(HANG_S)
    assert bench.answer("motion").state is State.OLD and bench.answer("motion").value.plan
    bench.look(2)  # asks nothing
    assert bench.answer("image").state is State.OLD
    bench.undo()
    assert bench.settle(HANG_S)
    assert bench.answer("motion").state is State.FRESH


def test_a_view_is_looked_at_and_a_volume_is_asked_for(bench: Workbench) -> None:
    before = bench.answer("image").value
    bench.look(5)
    bench.ask(SmallVolume(bench.draft.source, 16))
    assert bench.settle(HANG_S)
    assert not np.array_equal(bench.answer("image").value, before)
    assert bench.answer("volume").state is State.FRESH
    bench.set({"trajectory.views": 6})
    assert bench.settle(HANG_S)
    assert bench.answer("volume").state is State.OLD


def test_the_sphere_becomes_finer(bench: Workbench) -> None:
    coarse = bench.answer("sphere").value
    bench.refine()
    assert bench.settle(HANG_S)
    finer = bench.answer("sphere").value
    assert len(finer.directions) == len(finer.both) == 2 * len(coarse.directions)
    np.testing.assert_array_equal(finer.both[: len(coarse.both)], coarse.both)
    far = np.linalg.norm(finer.directions[:, None] - coarse.directions, axis=2)
    assert far[len(coarse.both) :].min() > 0.01  # all of them are new
