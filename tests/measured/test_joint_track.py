"""Readings of joints: fitted at the images, with gaps, and with stamps that run backwards."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.measured.driven import _usable
from twinct.measured.joint_track import JointReadings, JointTrack, track_of

NAMES = {"left_a": "source_a", "left_b": "source_b", "right_a": "detector_a"}
MS = 1_000_000


def told(stamps_ms: list[float], *rows: list[float]) -> tuple[list[int], list[list[float]]]:
    return [round(t * MS) for t in stamps_ms], list(rows)


def path(time_s: np.ndarray) -> np.ndarray:
    return np.stack([np.sin(3 * time_s), 0.2 * time_s**2], axis=1)


def test_noise_falls_and_motion_stays() -> None:
    rng = np.random.default_rng(5)
    ticks = np.arange(0, 2, 0.002)
    at = np.linspace(0.1, 1.9, 300)
    sigma = np.radians(0.001)
    noisy = path(ticks) + rng.normal(0, sigma, (len(ticks), 2))
    found, speed, there = JointReadings(("a", "b"), ticks, noisy).at(at)
    assert there.all()
    error = np.sqrt(np.mean((found - path(at)) ** 2))
    straight = np.stack([np.interp(at, ticks, column) for column in noisy.T], axis=1)
    assert error < 0.5 * np.sqrt(np.mean((straight - path(at)) ** 2))
    np.testing.assert_allclose(speed[:, 0], 3 * np.cos(3 * at), atol=0.01)


def test_images_without_readings_about_them_are_left_out() -> None:
    ticks = np.concatenate([np.arange(0, 1, 0.002), np.arange(1.5, 2, 0.002)])
    found, _, there = JointReadings(("a", "b"), ticks, path(ticks)).at(
        np.array([-0.1, 0.5, 1.2, 3.0])
    )
    assert there.tolist() == [False, True, False, False]
    assert np.isnan(found[~there]).all()


def test_stamps_that_run_backwards_are_named_and_left_out() -> None:
    heard = {
        ("left_b", "left_a"): told([1, 2, 3, 1.5, 4], [0, 1], [0, 2], [0, 3], [9, 9], [0, 4]),
        ("right_a",): told([1, 2], [5], [6]),
    }
    track, sentences = track_of(heard, NAMES, tuple(NAMES.values()), 0)
    left = track.groups[0]
    assert left.joints == ("source_b", "source_a")
    assert left.position[:, 1].tolist() == [1, 2, 3, 4]
    (sentence,) = sentences
    assert "1 of 5 readings are left out, the first is 1.500 ms before" in sentence
    assert track.one_time


@pytest.mark.parametrize("back_s", [0.02, 0.5])
def test_no_image_is_taken_between_two_times_of_one_stamp(back_s: float) -> None:
    """Wherever an image has a pose, it is the true one; only those about the jump have none."""
    true_s = np.arange(0, 3, 0.002)
    set_back = 1.0
    stamps = np.where(true_s < set_back, true_s, true_s - back_s)
    rows = path(true_s).tolist()
    heard = {("left_a", "left_b"): ([round(t * 1e9) for t in stamps], rows)}
    names = {"left_a": "a", "left_b": "b"}
    track, _ = track_of(heard, names, ("a", "b"), 0)
    assert not track.one_time
    images = np.arange(0.1, 2.9 - back_s, 0.0013)
    found, _, there = track.at(images)
    true = path(np.where(images < set_back, images, images + back_s))
    np.testing.assert_allclose(found[there], true[there], atol=1e-6)
    lost = images[~there]
    assert set_back - 0.003 < lost.min() and lost.max() < set_back + 0.003


def test_joints_that_nobody_told_of_are_named() -> None:
    heard = {("left_a", "left_b"): told([1, 2], [0, 0], [0, 0])}
    with pytest.raises(InputError, match="no joint state contains detector_a; they contain left_a"):
        track_of(heard, NAMES, tuple(NAMES.values()), 0)


def test_positions_that_are_not_finite_are_refused() -> None:
    heard = {("left_a", "left_b"): told([1, 2], [0, np.nan], [0, 0])}
    with pytest.raises(InputError, match="not finite"):
        track_of(heard, NAMES, tuple(NAMES.values()), 0)


def test_images_whose_stamps_run_backwards_are_named_and_left_out() -> None:
    ticks = np.arange(0, 2, 0.002)
    track = JointTrack(("a", "b"), (JointReadings(("a", "b"), ticks, path(ticks)),))
    kept, told = _usable(track, np.array([0.5, 0.7, 0.6, 0.9, 5.0]), 0.01)
    assert kept.tolist() == [0, 1, 3]
    assert told == (
        "images 2 have stamps that run backwards: left out",
        "images 4 have no joint states about their time: left out",
    )
    with pytest.raises(InputError, match=r"one clock\? The first of 1 comes 9.000 s after"):
        _usable(track, np.array([9.0]), 0.0)
    with pytest.raises(InputError, match="after the first joint state; stamps of a run backwards"):
        _usable(track, np.array([9.0]), 0.0, ("stamps of a run backwards",))
