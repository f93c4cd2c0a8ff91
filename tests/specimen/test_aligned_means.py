"""Means of a field on a grid with its axes: those of all samples, in a fraction of the time."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.geometry import Pose, VolumeGrid
from twinct.specimen import grey_part
from twinct.specimen.aligned_means import field_axes

OF = VolumeGrid((9, 8, 10), (1.5, 2.0, 2.2), Pose.from_euler((1, 2, 3), (0, 0, 0)))


@pytest.mark.parametrize(
    ("turn", "shape", "voxel", "centre"),
    [
        ((0, 0, 0), (9, 8, 7), 2.0, (3.3, -1.2, 2.0)),
        ((90, 0, 0), (7, 9, 8), 1.7, (2.0, 1.0, -3.0)),
        ((0, 90, 180), (9, 5, 7), (3.3, 1.0, 2.0), (0.0, 0.0, 0.0)),
        ((0, 0, -90), (11, 12, 13), 0.6, (2.0, -2.0, 4.0)),
        ((0, 0, 0), (4, 4, 4), 7.0, (0.0, 0.0, 0.0)),
        ((0, 0, 0), (4, 4, 4), 2.0, (60.0, 0.0, 0.0)),
    ],
)
def test_sums_along_the_axes_are_the_means_of_the_samples(
    monkeypatch: pytest.MonkeyPatch,
    turn: tuple[float, float, float],
    shape: tuple[int, int, int],
    voxel: float | tuple[float, float, float],
    centre: tuple[float, float, float],
) -> None:
    values = np.random.default_rng(0).random(OF.shape, dtype=np.float32)
    grid = VolumeGrid(shape, voxel, Pose.from_euler(centre, (0, 0, 0)))
    place = Pose.from_euler((1, -2, 0.5), turn)
    fast, slow = np.ones(shape, np.float32), np.ones(shape, np.float32)
    grey_part.add_means(values, OF, grid, place, fast)
    monkeypatch.setattr(grey_part, "add_aligned_means", lambda *_: False)
    grey_part.add_means(values, OF, grid, place, slow)
    assert fast == pytest.approx(slow, abs=3e-7)
    assert (fast.max() > 1.2) == (centre[0] < 60)


def test_turned_axes_are_known() -> None:
    assert field_axes(np.diag([1.0, 2, 3])) == (0, 1, 2)
    assert field_axes(np.array([[0, 0, -1.0], [2, 0, 0], [0, 1, 0]])) == (2, 0, 1)
    assert field_axes(np.array([[1, 1e-4, 0], [0, 1.0, 0], [0, 0, 1]])) is None
