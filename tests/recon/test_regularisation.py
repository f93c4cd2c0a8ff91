"""The strength of the total variation follows from noise, views and pixels."""

import numpy as np
import pytest

from twinct.geometry import Panel, VolumeGrid
from twinct.recon import Projector
from twinct.recon.air import KnownNoise
from twinct.recon.regularisation import PER_NOISE, strength_of_noise


def scan(circle, views=16, pixels=24, voxels=16, size_mm=32.0):
    geometry = circle(views, Panel(pixels, pixels, 48.0 / pixels, 48.0 / pixels))
    return Projector(geometry, VolumeGrid((voxels,) * 3, size_mm / voxels))


def strength(A, deviation=0.01, length=0.0, mask=None):
    p = np.full(A.range_shape, length, np.float32)
    return strength_of_noise(A, p, KnownNoise(np.full(len(A), deviation), "photons"), mask)


def test_strength_is_that_of_the_formula(circle):
    A = scan(circle)
    lengths = A.chords()
    view = A.geometry[0]
    near = np.linalg.norm(view.source[0]) / np.linalg.norm(view.detector[0] - view.source[0])
    mean = lengths[lengths > 0].mean()
    expected = PER_NOISE * 0.01 * 2.0 * near / (np.sqrt(16) * mean)
    assert strength(A) == pytest.approx(expected, rel=1e-5)


def test_strength_follows_noise_views_and_pixels_but_not_voxels(circle):
    base = strength(scan(circle))
    assert strength(scan(circle), 0.02) == pytest.approx(2 * base)
    assert strength(scan(circle), length=2.0) == pytest.approx(np.e * base, rel=1e-4)
    assert strength(scan(circle, views=64)) == pytest.approx(base / 2, rel=0.02)
    assert strength(scan(circle, pixels=48)) == pytest.approx(base / 2, rel=0.05)
    assert strength(scan(circle, voxels=32)) == pytest.approx(base, rel=1e-3)


def test_pixels_that_do_not_count_tell_nothing(circle):
    A = scan(circle)
    p = np.zeros(A.range_shape, np.float32)
    p[:, :4] = 5.0
    mask = np.ones(A.range_shape[1:], np.bool_)
    mask[:4] = False
    noise = KnownNoise(np.full(len(A), 0.01), "air")
    assert strength_of_noise(A, p, noise, mask) == pytest.approx(strength(A), rel=1e-6)
    assert strength_of_noise(A, p, noise, None) > 1.5 * strength(A)
    assert strength_of_noise(A, p, noise, np.zeros_like(mask)) == 0.0
