"""Voxel lattices."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from twinct.geometry import Pose, VolumeGrid

ROUNDING = 1e-9
"""mm; float64 over a few voxels."""


def test_grid_affine_and_axes_agree() -> None:
    grid = VolumeGrid((3, 4, 5), (1.0, 2.0, 3.0), Pose.from_euler([10, 20, 30], [0, 0, 90]))
    x, y, z = grid.axes()
    local = np.array([x[4], y[1], z[2]])
    np.testing.assert_allclose(
        grid.affine @ [4, 1, 2, 1], [*grid.world_from_grid.apply(local), 1], atol=ROUNDING
    )
    np.testing.assert_array_equal(grid.size_mm, [5, 8, 9])
    np.testing.assert_array_equal(grid.first_voxel_mm, [axis[0] for axis in (x, y, z)])


def test_repr_evaluates_to_an_equal_grid() -> None:
    grid = VolumeGrid((3, 4, 5), (1, 2, 3), Pose.from_euler([1, 2, 3], [4, 5, 6]))
    assert eval(repr(grid), {"VolumeGrid": VolumeGrid, "Pose": Pose}) == grid


@pytest.mark.parametrize(
    ("voxel", "pose", "told"),
    [
        (0.5, None, "5 x 4 x 3 voxels of 0.5 mm about (0, 0, 0) mm"),
        (
            (1, 2, 1),
            Pose.from_euler([1.5, 0, -2], [0, 0, 90]),
            "5 x 4 x 3 voxels of 1 x 2 x 1 mm about (1.5, 0, -2) mm, turned by (0, 0, 90) deg",
        ),
    ],
)
def test_a_message_states_a_grid_in_words(voxel: Any, pose: Pose | None, told: str) -> None:
    assert str(VolumeGrid((3, 4, 5), voxel, pose)) == told
