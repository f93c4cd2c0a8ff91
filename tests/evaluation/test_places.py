"""Which voxels a region has: against their definition on all voxels of a grid."""

import numpy as np

from twinct.evaluation.region_voxels import ball, centres, cuboid, cylinder, shell
from twinct.geometry import Pose, VolumeGrid

GRID = VolumeGrid((20, 24, 28), (1.0, 0.8, 1.2), Pose.from_euler((5, -3, 2), (10, 20, 30)))
EVERYWHERE = tuple(slice(0, n) for n in GRID.shape)
PLACE = Pose.from_euler((8, -1, 0), (40, 0, 15))


def whole(voxels):
    mask = np.zeros(GRID.shape, bool)
    mask[voxels.box] = voxels.mask
    return mask


def test_shapes_turned_and_cut_by_the_grid() -> None:
    x, y, z = np.moveaxis(centres(GRID, EVERYWHERE, PLACE), -1, 0)
    cases = {
        "ball": (ball(GRID, PLACE, 6), np.sqrt(x**2 + y**2 + z**2) <= 6),
        "cylinder": (cylinder(GRID, PLACE, 4, 30), (np.hypot(x, y) <= 4) & (abs(z) <= 15)),
        "box": (
            cuboid(GRID, PLACE, (4, 9, 14)),
            (abs(x) <= 2) & (abs(y) <= 4.5) & (abs(z) <= 7),
        ),
    }
    for name, (found, expected) in cases.items():
        np.testing.assert_array_equal(whole(found), expected, err_msg=name)
        assert len(found) == expected.sum() > 50
        assert found.mask.size < GRID.shape[0] * GRID.shape[1] * GRID.shape[2]


def test_centres_are_the_grids() -> None:
    points = centres(GRID, EVERYWHERE)
    index = np.array([7, 3, 11])
    expected = GRID.affine @ [*index[::-1], 1]
    np.testing.assert_allclose(points[tuple(index)], expected[:3])


def test_a_shell_lies_around_a_body() -> None:
    body = ball(GRID, Pose.from_euler(GRID.world_from_grid.position, (0, 0, 0)), 3)
    for from_mm, to_mm in ((2.1, 3.9), (0.0, 1.0), (0.8, 1.2)):  # on nodes, too
        check_shell(body, from_mm, to_mm)


def check_shell(body, from_mm, to_mm) -> None:
    found = whole(shell(body, GRID, from_mm, to_mm))
    inner = centres(GRID, EVERYWHERE)[whole(body)]
    outer = centres(GRID, EVERYWHERE).reshape(-1, 3)
    nearest = np.min([np.linalg.norm(outer - p, axis=1) for p in inner], axis=0)
    expected = (nearest >= from_mm - 1e-9) & (nearest <= to_mm + 1e-9) & (nearest > 1e-9)
    np.testing.assert_array_equal(found, expected.reshape(GRID.shape))


def test_outside_of_the_grid_there_is_nothing() -> None:
    assert len(ball(GRID, Pose.from_euler((500, 0, 0), (0, 0, 0)), 6)) == 0
    assert len(cuboid(GRID, Pose.from_euler((-500, 0, 0), (0, 0, 0)), (1, 1, 1))) == 0


def test_values_are_those_of_its_voxels() -> None:
    array = np.random.default_rng(0).random(GRID.shape).astype(np.float32)
    found = cylinder(GRID, PLACE, 4, 30)
    np.testing.assert_array_equal(found.of(array), array[whole(found)])
    assert found.of(array).dtype == np.float64
