"""A plan that was sent, beside the images: which view each image shows, and when."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.geometry import Pose
from twinct.geometry.wire import PosePairs
from twinct.measured.sent_plan import SentPlan
from twinct.robots.motion import MotionPlan
from twinct.runs.predicted_and_measured import drive_times, stored_predictions

TIME_S = np.array([0.0, 1.0, 2.0, 4.0, 5.0])
LAG_S, START_S = 0.008, 10.0


@pytest.fixture(scope="module")
def sent() -> SentPlan:
    """Three views, due 1, 2 and 4 s after the start of a plan that is driven at half the speed."""
    poses = [Pose(np.array([x, 0.0, 0.0]), np.array([0.0, 0.0, 0.0, 1.0])) for x in (1, 2, 3)]
    plan = MotionPlan(
        ("source_a", "detector_a"),
        TIME_S,
        np.zeros((5, 3, 2)),
        np.array([-1, 0, 1, 2, -1]),
        tuple(PosePairs.at(pose, pose) for pose in poses),
        np.zeros(3),
        (("a", "b"),) * 3,
    )
    return SentPlan(plan, START_S, 2.0, LAG_S)


def test_each_image_shows_the_view_whose_time_it_is(sent: SentPlan) -> None:
    taken_s = START_S + 2 * np.array([1.0, 4.0]) + LAG_S + 0.1
    views = sent.views_at(taken_s)
    assert views is not None and views.tolist() == [0, 2]
    assert [pose.position[0] for pose in sent.commanded(views).source] == [1, 3]
    beside = sent.beside(views, taken_s)
    assert beside["planned_s"] == [2, 8]
    assert beside["taken_s"] == pytest.approx([2.108, 8.108])


@pytest.mark.parametrize(
    "taken_s", [[12.0, 12.1, 14.0], [12.0, 14.0, 16.2], [5.0, 14.0]], ids=["two", "off", "early"]
)
def test_images_that_are_no_views_of_the_plan_show_none(
    sent: SentPlan, taken_s: list[float]
) -> None:
    assert sent.views_at(np.array(taken_s)) is None


def test_a_single_view_is_that_view(sent: SentPlan) -> None:
    plan = replace(sent.plan, views=np.array([-1, 0, -1, -1, -1]), targets=sent.plan.targets[:1])
    views = replace(sent, plan=plan).views_at(np.array([12.3]))
    assert views is not None and views.tolist() == [0]


def test_figures_of_a_drive(tmp_path: Path) -> None:
    file = tmp_path / "drive.json"
    assert drive_times(file) == {}
    times = {"planned_s": [1.0, 3.0], "taken_s": [1.002, 3.004]}
    file.write_text(json.dumps({"lag_ms": 2.5, "latency_ms": 12.0, **times}))
    drive = drive_times(file)["drive"]
    assert drive["late_ms"] == pytest.approx({"mean": 3.0, "std": 1.0, "max": 4.0})
    assert (drive["planned_s"], drive["taken_s"]) == pytest.approx((2.0, 2.002))
    file.write_text(json.dumps({"lag_ms": None, "latency_ms": 0.0}))
    assert drive_times(file) == {"drive": {"lag_ms": None, "latency_ms": 0.0}}
    file.write_text("{}")
    with pytest.raises(InputError, match=r"drive\.json.*lag_ms"):
        drive_times(file)


def test_there_may_be_no_predictions(tmp_path: Path) -> None:
    assert stored_predictions(tmp_path / "predictions") == []
