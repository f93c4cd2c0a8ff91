"""Pose errors of known displacements and rotations."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twinct.evaluation import pose_errors, tool_speeds
from twinct.geometry import Pose
from twinct.geometry.wire import PosePairs

ROUNDING = 1e-9
"""mm and degrees: float64 arithmetic on lengths of some hundred mm and half-angle square roots."""


def poses(rng, views):
    quats = Rotation.random(views, rng=rng).as_quat()
    return tuple(Pose(p, q) for p, q in zip(rng.uniform(-300, 300, (views, 3)), quats, strict=True))


def moved(pose, shift, rotvec_deg):
    """Shifted in the world and turned about axes of the tool."""
    turn = Rotation.from_quat(pose.quat) * Rotation.from_rotvec(rotvec_deg, degrees=True)
    return Pose(pose.position + shift, turn.as_quat())


def test_known_errors_come_back():
    rng = np.random.default_rng(5)
    commanded = PosePairs(poses(rng, 3), poses(rng, 3))
    shifts = np.array([[3.0, 4.0, 0.0], [0.0, 0.0, -1.0], [2.0, -2.0, 1.0]])  # 5, 1, 3 mm
    turns = np.array([[0.0, 0.0, 0.5], [-0.2, 0.0, 0.0], [0.0, 90.0, 0.0]])
    executed = PosePairs(
        tuple(moved(p, s, t) for p, s, t in zip(commanded.source, shifts, turns, strict=True)),
        tuple(
            moved(p, 2 * s, 0 * t)
            for p, s, t in zip(commanded.detector, shifts, turns, strict=True)
        ),
    )
    errors = pose_errors(commanded, executed)
    np.testing.assert_allclose(errors.source.position_mm, [5, 1, 3], atol=ROUNDING)
    np.testing.assert_allclose(errors.source.rotation_deg, [0.5, 0.2, 90], atol=ROUNDING)
    np.testing.assert_allclose(errors.detector.position_mm, [10, 2, 6], atol=ROUNDING)
    np.testing.assert_allclose(errors.detector.rotation_deg, 0, atol=2e-6)  # arccos-free, sqrt(eps)

    position = errors.summary()["source"]["position_mm"]
    assert position["mean"] == pytest.approx(3.0)
    assert position["std"] == pytest.approx(np.sqrt(8 / 3)), "ddof 0"
    assert position["max"] == pytest.approx(5.0)
    assert errors.summary()["detector"]["position_mm"]["max"] == pytest.approx(10.0)
    assert errors.summary()["source"]["rotation_deg"]["max"] == pytest.approx(90.0)


def test_opposite_quaternions_are_the_same_rotation():
    pose = Pose([1, 2, 3], [0.5, 0.5, 0.5, 0.5])
    flipped = Pose(pose.position, -pose.quat)
    errors = pose_errors(PosePairs((pose,), (pose,)), PosePairs((flipped,), (flipped,)))
    assert errors.source.rotation_deg[0] == pytest.approx(0, abs=ROUNDING)


def test_views_must_match():
    pose = Pose.identity()
    with pytest.raises(ValueError, match="2 commanded and 1 executed"):
        pose_errors(PosePairs((pose,) * 2, (pose,) * 2), PosePairs((pose,), (pose,)))
    with pytest.raises(ValueError, match="at least one"):
        pose_errors(PosePairs((), ()), PosePairs((), ()))


def test_speeds_are_way_over_time():
    """A source that goes 3 mm in 0.1 s and then rests; a panel on the diagonal."""
    source = [Pose((x, 0, 0), (0, 0, 0, 1)) for x in (0.0, 3.0, 3.0)]
    detector = [Pose((x, x, 0), (0, 0, 0, 1)) for x in (0.0, 1.0, 2.0)]
    found = tool_speeds(PosePairs(tuple(source), tuple(detector)), np.array([1.0, 1.1, 1.3]))
    assert found["source"] == pytest.approx({"mean": 15.0, "max": 30.0})
    assert found["detector"]["max"] == pytest.approx(10 * np.sqrt(2))
