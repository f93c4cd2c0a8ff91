"""Parameters of a family: a known optimum, what cannot be had, and a circle's best tilt."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from twinct.core.errors import InputError
from twinct.geometry import Panel, Pose, ScanGeometry
from twinct.rays import Body
from twinct.trajectory import CircleTrajectory, commanded_views
from twinct.view_planning import best_parameters, metal_paths

BOUNDS = {"a": (-10.0, 30.0), "b": (0.0, 1.0)}


def bowl(sets):
    return [-((p["a"] - 17) ** 2) / 400 - (p["b"] - 0.2) ** 2 for p in sets]


def test_it_finds_the_bottom_of_a_bowl_whatever_the_units() -> None:
    found = best_parameters(bowl, BOUNDS, generations=60, seed=1)
    assert found.parameters["a"] == pytest.approx(17, abs=0.05)
    assert found.parameters["b"] == pytest.approx(0.2, abs=0.005)
    assert found.worth == pytest.approx(bowl([found.parameters])[0])
    assert list(found.history) == sorted(found.history)


def test_the_seed_alone_decides() -> None:
    one, same, other = (best_parameters(bowl, BOUNDS, generations=3, seed=s) for s in (4, 4, 5))
    assert one == same != other


def test_what_cannot_be_had_is_gone_round() -> None:
    def half(sets):
        return [
            -np.inf if p["a"] > 12 else value for p, value in zip(sets, bowl(sets), strict=True)
        ]

    found = best_parameters(half, BOUNDS, generations=60, seed=1, start={"a": 0, "b": 0.5})
    assert found.parameters["a"] == pytest.approx(12, abs=0.1)


def test_a_circle_is_tilted_out_of_the_metal() -> None:
    """Two rods along x beside the region, level with it: a level circle looks through them."""
    rods = [
        trimesh.creation.box((60, 6, 6), transform=trimesh.transformations.translation_matrix(at))
        for at in ([0, 14, 0], [0, -14, 0])
    ]
    metal = [(Body(rod.vertices, rod.faces), Pose.identity()) for rod in rods]
    panel = Panel(30, 40, 8.0, 8.0)

    def views(p) -> ScanGeometry:
        keys = {"tilt_deg": p["tilt"], "tilt_axis_deg": p["axis"]}
        return commanded_views(CircleTrajectory(kind="circle", views=24, **keys), panel)

    def past(sets):
        return [-metal_paths(views(p), metal, [[0.0, 0, 0]]).mean() for p in sets]

    level = past([{"tilt": 0.0, "axis": 0.0}])[0]
    bounds = {"tilt": (0.0, 60.0), "axis": (-90.0, 90.0)}
    found = best_parameters(past, bounds, generations=12, seed=2)
    assert found.worth > 0.5 * level  # both are negative: half of the metal at most
    # About x every view climbs over the rods but those along them.
    assert abs(found.parameters["axis"]) < 45 and found.parameters["tilt"] > 15


def test_bad_input_is_told() -> None:
    with pytest.raises(InputError, match="a: the bounds 3 to 1"):
        best_parameters(bowl, {"a": (3, 1), "b": (0, 1)})
    with pytest.raises(InputError, match="needs at least two"):
        best_parameters(bowl, {"a": (0, 1)})
    with pytest.raises(InputError, match="b: 2 lies outside"):
        best_parameters(bowl, BOUNDS, start={"a": 0, "b": 2})
    with pytest.raises(InputError, match="none of 12 parameter sets"):
        best_parameters(lambda sets: [-np.inf] * len(sets), BOUNDS, generations=2)
