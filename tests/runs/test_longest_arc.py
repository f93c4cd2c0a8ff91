"""The refusal of a full circle names the longest arc of which a plan was made."""

from __future__ import annotations

import re

import numpy as np
import pytest
import yaml

from twinct.robots.reach import Holder, TargetPoses
from twinct.runs.longest_arc import _orbit, _split, _stretches, longest_arc
from twinct.scan import SimulationBuilder
from twinct.scenario import load_scenario


def builder(**trajectory: object) -> SimulationBuilder:
    return SimulationBuilder(
        load_scenario(
            {
                "trajectory": trajectory,
                "specimen": {
                    "parts": [
                        {"shape": {"kind": "sphere", "radius_mm": 50, "mesh_resolution_mm": 8}}
                    ]
                },
            }
        )
    )


def _lost(circle: SimulationBuilder) -> list[int]:
    asked = circle.requested
    poses = TargetPoses.of(asked)
    held = Holder(circle.cell, circle.scenario.motion, roll_free=circle.roll_free).held(poses)
    return np.flatnonzero(~held).tolist()


def test_the_arc_that_is_named_is_planned_and_consists_of_views_of_the_circle() -> None:
    circle = builder(kind="circle", views=24, centre_longitude_deg=100)
    asked = circle.requested
    told = longest_arc(circle, _lost(circle))
    assert told is not None
    found = re.search(r"trajectory: (\{.*\})", told)
    assert found is not None
    arc = builder(**yaml.safe_load(found[1]))
    assert arc.plan is not None
    views = arc.requested.source
    assert 8 < len(views) < 24
    far = np.linalg.norm(views[:, None] - asked.source[None], axis=2).min(axis=1)
    assert far.max() < 1e-3


@pytest.mark.parametrize("wide", [360, 300])
def test_a_wide_arc_has_one_that_consists_of_its_views(wide: float) -> None:
    whole = builder(kind="arc", views=25, longitude_range_deg=wide, centre_longitude_deg=100)
    said = longest_arc(whole, _lost(whole))
    assert said is not None
    found = re.search(r"trajectory: (\{.*\})", said)
    assert found is not None
    arc = builder(**yaml.safe_load(found[1])).requested.source
    assert 8 < len(arc) < 25
    far = np.linalg.norm(arc[:, None] - whole.requested.source[None], axis=2).min(axis=1)
    assert far.max() < 1e-3


def test_only_circles_and_arcs_have_one() -> None:
    assert longest_arc(builder(kind="sinusoid", views=3), [0]) is None


def test_an_arc_is_cut_at_its_lost_views_and_at_blocked_ways() -> None:
    arc = _orbit(builder(kind="arc", views=10, longitude_range_deg=180))
    turn = _orbit(builder(kind="arc", views=9, longitude_range_deg=360))
    assert arc is not None
    assert turn is not None
    assert arc.stretches({2, 5}, ()) == [range(2), range(3, 5), range(6, 10)]
    assert arc.stretches((), [4]) == [range(4), range(4, 10)]
    assert turn.stretches({3, 8}, ()) == [range(1, 3), range(4, 8)]
    assert turn.stretches((), [3, 6]) == [range(3, 3), range(3, 6), range(6, 11)]


def test_stretches_go_on_past_the_last_view() -> None:
    assert _stretches({2, 5}, 8) == [range(3, 5), range(6, 10)]
    assert _stretches(set(), 8) == [range(8)]
    assert _stretches(set(range(8)), 8) == [range(1, 1)] + [range(k, k) for k in range(2, 9)]


def test_a_stretch_is_split_where_problems_lie() -> None:
    stretch = range(6, 16)
    assert _split(stretch, [2, 3, 7], False) == [
        *(range(6, 8), range(9, 9)),
        *(range(10, 13), range(14, 16)),
    ]
    assert _split(stretch, [4], True) == [range(6, 10), range(10, 16)]
    assert _split(stretch, [], False) == [range(7, 15)]
