"""Ways round a closed straight path: clear, inside the ranges, the same for the same seed."""

from __future__ import annotations

import hashlib
import subprocess
import sys

import numpy as np
import pytest

from twinct.geometry import Floats
from twinct.robots.cell import CellModel, Clearance
from twinct.robots.motion.feasible import SHORTFALL_MM, Feasible
from twinct.robots.motion.path_planner import Detours

LEAST_MM = 10.5

START, END = np.array(
    [
        [3.55, -0.75, 1.42, 4.94, -2.7, 2.52, 0.76, -2.88, -1.0, 3.47, 0.75, 0.3],
        [2.46, -0.21, 2.49, 0.85, -0.89, 0.01, 0.65, -2.92, -2.51, 2.28, 0.93, 3.15],
    ]
)
"""Two views of the paper, 160 views apart: on the straight path the arms meet."""

ELSEWHERE = """
import hashlib
import numpy as np
import trimesh
from twinct.robots.cell import build_cell
from twinct.geometry import Pose
from twinct.robots.motion.path_planner import Detours
from twinct.robots.motion.feasible import Feasible
from twinct.scenario import Detector, load_scenario
head = trimesh.creation.icosphere(subdivisions=3)
head.apply_scale((72.0, 90.0, 110.0))
section = load_scenario("scenarios/paper.yaml").cell
cell = build_cell(section, head, Pose.identity(), Detector().panel)
turns = np.ptp(cell.joint_ranges, axis=1) > 3 * np.pi
planner = Detours(cell, Feasible(cell), turns, 1)
way = planner.between(np.array({start}), np.array({end}), 10.5, 0)
print(hashlib.sha256(way.tobytes()).hexdigest())
"""


def planner(cell: CellModel, seed: int) -> Detours:
    return Detours(cell, Feasible(cell), np.ptp(cell.joint_ranges, axis=1) > 3 * np.pi, seed)


BELOW, ABOVE = np.array(
    [[0.77, -2.95, -1.01, -2.94, 0.74, -2.66], [0.8, 2.46, 1.23, 2.52, 0.7, 3.2]]
)
"""Of the source arm: from the one to the other the upper arm goes over the top, a turn on."""


def is_clear(cell: CellModel, way: Floats) -> None:
    shares = np.linspace(0, 1, 150)[:, None]
    dense = [a + shares * (b - a) for a, b in zip(way[:-1], way[1:], strict=True)]
    assert Clearance(cell).over(np.vstack(dense)).distance_mm >= LEAST_MM - SHORTFALL_MM


@pytest.mark.parametrize("turning", [False, True])
def test_a_way_round_is_clear_and_ends_as_told(cell: CellModel, turning: bool) -> None:
    assert not Feasible(cell).straight(START[None], END[None], LEAST_MM)[0]
    way = planner(cell, 1).between(START, END, LEAST_MM, 0, turning=turning)
    assert way is not None
    np.testing.assert_array_equal(way[0], START)
    turns = (way[-1] - END) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.rint(turns), atol=1e-12)
    assert not turns[[2, 8]].any()  # elbows
    if not turning:
        np.testing.assert_array_equal(way[-1], END)
        low, high = cell.joint_ranges.T
        assert (way >= low).all() and (way <= high).all()
    is_clear(cell, way)


def test_which_turn_a_way_ends_in_is_found_with_it(cell: CellModel) -> None:
    """With the end told as it is, the upper arm would have to go through its own foot."""
    start, end = np.hstack([BELOW, START[6:]]), np.hstack([ABOVE, START[6:]])
    detours = planner(cell, 1)
    assert detours.between(start, end, LEAST_MM, 0, turning=False) is None
    way = detours.between(start, end, LEAST_MM, 0)
    assert way is not None
    assert abs(way[-1, 1] - (end[1] - 2 * np.pi)) < 1e-12
    is_clear(cell, way)


def test_what_is_shut_in_is_given_up(cell: CellModel) -> None:
    """No way out of a clearance that hardly any configuration has."""
    assert planner(cell, 1).between(START, END, 60.0, 0) is None


@pytest.mark.process
def test_the_same_seed_gives_the_same_bytes_in_any_process_after_anything(cell: CellModel) -> None:
    way = planner(cell, 1).between(START, END, LEAST_MM, 0)
    other = planner(cell, 2).between(START, END, LEAST_MM, 0)
    again = planner(cell, 1).between(START, END, LEAST_MM, 0)
    assert way is not None and other is not None and again is not None
    np.testing.assert_array_equal(way, again)
    assert not np.array_equal(way, other)
    code = ELSEWHERE.format(start=START.tolist(), end=END.tolist())
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == hashlib.sha256(way.tobytes()).hexdigest()
    assert not run.stderr  # OMPL's binding tells of objects that were never freed
