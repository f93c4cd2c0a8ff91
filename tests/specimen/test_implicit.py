"""One model of solids, in a canvas and in the kernels of organs: both mean the same shape."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.specimen import _phantom
from twinct.specimen.canvas import Canvas
from twinct.specimen.implicit import ImplicitSolid, ball, block, chain, ellipsoid, rod
from twinct.specimen.organs import Organ, table
from twinct.specimen.phantom import Phantom

SINGLE_MM = 1e-4
"""Canvases compute in single precision, at distances below 100 mm."""


@pytest.fixture
def points() -> np.ndarray:
    return np.random.default_rng(5).uniform(-30, 30, (400, 3))


def by_kernel(solid: ImplicitSolid, points: np.ndarray) -> np.ndarray:
    rows = table((Organ("one", 0.0, (solid,)),), 0)
    return np.array([_phantom._distance(rows.solids, 0, rows.lattices, *p) for p in points])


def drawn() -> ImplicitSolid:
    canvas = Canvas(1.0, (0, -40, -40), (40, 40, 40))
    canvas.draw(ellipsoid((4, 3, 0), (9, 12, 8)), rod((0, 0, 0), (0, 10, 15), 4, 3).blended(5))
    return canvas.solid((2, 1, -3))


@pytest.mark.parametrize(
    "solid",
    [
        ball((3, -4, 5), 8),
        ellipsoid((3, -4, 5), (12, 5, 8), (10, -30, 50)),
        rod((-10, 2, 3), (12, -5, 8), 6, 3, (1.5, 1, 0.8)),
        block((3, 2, -5), (10, 6, 8), 25, 2),
        drawn(),
    ],
    ids=["ball", "ellipsoid", "rod", "block", "canvas"],
)
def test_the_formula_and_the_kernels_agree_on_a_solid(
    solid: ImplicitSolid, points: np.ndarray
) -> None:
    x, y, z = points.T
    moved = solid.moved((3, 1, -2))
    for one, at in (
        (solid, (x, y, z)),
        (moved, (x + 3, y + 1, z - 2)),
        (solid.mirrored(), (-x, y, z)),
    ):
        there = np.stack(at, axis=1)
        told = one(*at)
        assert told == pytest.approx(by_kernel(one, there), abs=SINGLE_MM)
        assert told == pytest.approx(solid(x, y, z), abs=SINGLE_MM)
        inside = there[told < 0]
        assert len(inside) and ((one.low < inside) & (inside < one.high)).all()


def test_a_canvas_and_an_organ_agree_on_a_model(points: np.ndarray) -> None:
    model = (
        ellipsoid((0, 0, 0), (20, 16, 18)),
        rod((0, 0, 0), (22, 0, 9), 6).blended(4),
        rod((-22, 0, 9), (0, 0, 0), 6).blended(4),
        ball((0, 12, 0), 8).cut(3),
        block((0, 0, 2), (30, 30, 12), rounding=2).keep(2),
    )
    canvas = Canvas(0.5, (0, -40, -40), (40, 40, 40))
    canvas.draw(*model)
    distance = canvas.solid()(*points.T)
    clear = np.abs(distance) > 0.5
    labels = Phantom((Organ("all", 50.0, model),)).at(points)[1]
    assert np.array_equal(labels[clear] > 0, distance[clear] < 0)
    assert 0.05 < (labels > 0).mean() < 0.5
    assert canvas.surface().is_watertight


def test_a_formula_is_not_for_the_kernels() -> None:
    path = chain([(0, 0, 0), (5, 0, 0), (5, 5, 0)], [2, 2, 2])
    with pytest.raises(ValueError, match="drawn on a canvas"):
        table((Organ("path", 0.0, (path,)),), 0)
