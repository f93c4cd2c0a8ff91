"""Plans in files: the same plan and the same bytes, and what is no plan is said."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.robots.motion import MotionPlan, load_plan, plan_arrays, plan_of_arrays, save_plan


def test_a_plan_comes_back_as_it_was_and_the_file_has_the_same_bytes(
    plan: MotionPlan, tmp_path: Path
) -> None:
    first, again = tmp_path / "first.npz", tmp_path / "again.npz"
    save_plan(plan, first)
    read = load_plan(first)
    save_plan(read, again)
    assert read.digest == plan.digest
    assert read.nearest == plan.nearest
    assert np.array_equal(read.clearance_mm, plan.clearance_mm)
    assert again.read_bytes() == first.read_bytes()


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        ("state", lambda a: a[:, :, :-1], "state has the shape"),
        ("time_s", lambda a: a[::-1], "times do not increase from 0"),
        ("views", lambda a: np.where(a == 3, 4, a), "not every view is exposed exactly once"),
        ("source", lambda a: a * np.nan, "not finite"),
        ("state", lambda a: a + 1, "not at rest"),
        ("source", lambda a: a + 1e-9, "damaged"),
        ("format", lambda _: np.array("twinct plan 9"), "format is twinct plan 9"),
        ("joint_names", lambda _: 3, "not a valid plan"),
    ],
)
def test_what_is_no_plan_is_said(plan: MotionPlan, name: str, change, said: str) -> None:
    arrays = plan_arrays(plan)
    arrays[name] = change(arrays[name])
    with pytest.raises(InputError, match=f"^here: .*{said}"):
        plan_of_arrays(arrays, "here")


@pytest.mark.parametrize("length", [0, 40, -40])
def test_a_broken_file_is_one_message(plan: MotionPlan, length: int, tmp_path: Path) -> None:
    path = tmp_path / "plan.npz"
    save_plan(plan, path)
    path.write_bytes(path.read_bytes()[:length])
    with pytest.raises(InputError, match="plan.npz: the plan file "):
        load_plan(path)


def test_an_array_that_is_not_there_is_named(plan: MotionPlan) -> None:
    arrays = plan_arrays(plan)
    del arrays["views"]
    with pytest.raises(InputError, match="'views' is missing"):
        plan_of_arrays(arrays, "here")
