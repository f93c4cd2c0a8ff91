"""Voxel lattices."""

from __future__ import annotations

import numpy as np

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
