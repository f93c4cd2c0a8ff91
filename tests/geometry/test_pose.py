"""Poses and twists: group laws, derivatives, immutability."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.geometry import Pose

ROUNDING = 1e-9
"""mm; float64 over coordinates of some hundred mm, a few operations deep."""

DIFFERENCE = 1e-4
"""Central differences with steps of 1e-5 (mm or rad) at half a metre: 1e-10 mm of rounding over
the step, and the square of the step."""

STEP = 1e-5


def random_twist(rng: np.random.Generator, turn: float) -> np.ndarray:
    """v within half a metre, w with a given length."""
    w = rng.normal(size=3)
    return np.concatenate([rng.uniform(-500, 500, 3), turn * w / np.linalg.norm(w)])


def test_pose_group_laws(random_pose) -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        a, b, c = (random_pose(rng) for _ in range(3))
        points = rng.uniform(-100, 100, (5, 3))
        np.testing.assert_allclose((a @ b).apply(points), a.apply(b.apply(points)), atol=ROUNDING)
        np.testing.assert_allclose(((a @ b) @ c).matrix, (a @ (b @ c)).matrix, atol=ROUNDING)
        np.testing.assert_allclose((a @ a.inverse()).matrix, np.eye(4), atol=ROUNDING)
        np.testing.assert_allclose((a @ b).matrix, a.matrix @ b.matrix, atol=ROUNDING)


def test_pose_is_frozen_and_owns_its_numbers() -> None:
    position = np.zeros(3)
    pose = Pose(position, np.array([0.0, 0, 0, 1]))
    position[0] = 7
    assert pose.position[0] == 0
    with pytest.raises(ValueError, match="read-only"):
        pose.position[0] = 1
    with pytest.raises(ValueError, match="unit quaternion"):
        Pose(np.zeros(3), np.array([0, 0, 0, 2.0]))


def test_metres_keep_quaternions_and_positions() -> None:
    pose = Pose.from_metres([0.1, -0.2, 0.3], [0, 0, 1, 0])
    np.testing.assert_allclose(pose.position, [100, -200, 300], atol=ROUNDING)
    np.testing.assert_array_equal(pose.to_metres()[1], [0, 0, 1, 0])


def test_angle_is_that_of_the_relative_rotation() -> None:
    a = Pose.from_euler([0, 0, 0], [10, 20, 30])
    b = a @ Pose.from_euler([0, 0, 0], [0, 0, 0.25])
    assert a.angle_deg(b) == pytest.approx(0.25, abs=1e-9)


@pytest.mark.parametrize("turn", [0.0, 1e-12, 1e-7, 1e-3, 1.0, 3.1])
def test_log_undoes_exp(turn: float) -> None:
    twist = random_twist(np.random.default_rng(2), turn)
    np.testing.assert_allclose(Pose.exp(twist).log(), twist, atol=ROUNDING)


def test_exp_undoes_log(random_pose) -> None:
    rng = np.random.default_rng(3)
    for pose in [Pose.identity(), *(random_pose(rng) for _ in range(20))]:
        back = Pose.exp(pose.log())
        np.testing.assert_allclose(back.matrix, pose.matrix, atol=ROUNDING)


def test_exp_of_a_screw_computed_by_hand() -> None:
    # A quarter turn about z while the frame drives along its own x: a circle of 2 / pi * 100 mm.
    pose = Pose.exp([100, 0, 7, 0, 0, np.pi / 2])
    radius = 200 / np.pi
    np.testing.assert_allclose(pose.position, [radius, radius, 7], atol=ROUNDING)
    np.testing.assert_allclose(pose.rotation @ [1, 0, 0], [0, 1, 0], atol=ROUNDING)


def test_motions_along_one_twist_add_up() -> None:
    rng = np.random.default_rng(4)
    for _ in range(20):
        twist = random_twist(rng, rng.uniform(0, 2))
        there = Pose.exp(0.3 * twist) @ Pose.exp(0.7 * twist)
        np.testing.assert_allclose(there.matrix, Pose.exp(twist).matrix, atol=ROUNDING)
        np.testing.assert_allclose(
            Pose.exp(-twist).matrix, Pose.exp(twist).inverse().matrix, atol=ROUNDING
        )


def test_adjoint_moves_a_twist_from_the_tool_to_the_world(random_pose) -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        world_from_tool, twist = random_pose(rng), random_twist(rng, 1.0)
        right = world_from_tool @ Pose.exp(twist)
        left = Pose.exp(world_from_tool.adjoint() @ twist) @ world_from_tool
        np.testing.assert_allclose(right.matrix, left.matrix, atol=ROUNDING)


def test_adjoints_compose_like_poses(random_pose) -> None:
    rng = np.random.default_rng(6)
    a, b = random_pose(rng), random_pose(rng)
    # Entries are products of positions and rotations, so as large as a metre.
    np.testing.assert_allclose((a @ b).adjoint(), a.adjoint() @ b.adjoint(), atol=ROUNDING)
    np.testing.assert_allclose(a.inverse().adjoint() @ a.adjoint(), np.eye(6), atol=ROUNDING)


def test_derivatives_by_finite_differences(random_pose) -> None:
    """A twist on the right moves a point along the tool's axes, one on the left the world's."""
    rng = np.random.default_rng(7)
    pose, point = random_pose(rng), rng.uniform(-100, 100, 3)
    seen = pose.apply(point)
    right, left, velocity = np.empty((3, 6)), np.empty((3, 6)), np.empty((6, 6))
    for i, step in enumerate(STEP * np.eye(6)):
        there, back = Pose.exp(step), Pose.exp(-step)
        right[:, i] = ((pose @ there).apply(point) - (pose @ back).apply(point)) / (2 * STEP)
        left[:, i] = ((there @ pose).apply(point) - (back @ pose).apply(point)) / (2 * STEP)
        moved = [(pose @ motion @ pose.inverse()).log() for motion in (there, back)]
        velocity[:, i] = (moved[0] - moved[1]) / (2 * STEP)
    for found, axes, at in ((right, pose.rotation, point), (left, np.eye(3), seen)):
        expected = axes @ np.hstack([np.eye(3), np.cross(np.eye(3), at).T])
        np.testing.assert_allclose(found, expected, atol=DIFFERENCE)
    np.testing.assert_allclose(velocity, pose.adjoint(), atol=DIFFERENCE)


@pytest.mark.parametrize("wrong", [np.zeros(5), np.full(6, np.nan)])
def test_what_is_no_twist_is_refused(wrong: np.ndarray) -> None:
    with pytest.raises(ValueError, match="twist"):
        Pose.exp(wrong)
