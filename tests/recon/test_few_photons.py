"""Line integrals of pixels that few photons reach."""

import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.recon import integrals_of_photons

PHOTONS = 300.0


def counted(expected, seed=7):
    """Transmission of a scan by photons, in which an empty pixel has half of one."""
    counts = np.random.default_rng(seed).poisson(PHOTONS * np.exp(-expected))
    return (np.maximum(counts, 0.5) / PHOTONS).astype(np.float32)


@pytest.mark.parametrize("length", [0.0, 2.0, 3.5, 4.0, 4.5, 5.0, 6.0, 7.0])
def test_few_photons_do_not_bias_the_logarithm(length):
    """A flat shadow; -ln of the photons themselves is off by up to 0.18 above and 0.8 below."""
    expected = np.full((8, 64, 64), length)
    found = integrals_of_photons(counted(expected), PHOTONS)
    assert found.mean() - length == pytest.approx(0.0, abs=0.03)


def test_shadow_of_a_dense_rod_keeps_its_depth():
    across = np.linspace(-1.6, 1.6, 96)
    expected = np.broadcast_to(7 * np.sqrt(np.clip(1 - across**2, 0, None)), (8, 96, 96))
    transmission = counted(expected)
    off = (integrals_of_photons(transmission, PHOTONS) - expected).mean((0, 1))
    plain = (-np.log(transmission) - expected).mean((0, 1))
    assert np.abs(off).max() < 0.15
    assert np.abs(off[36:60]).max() < 0.1
    assert plain[36:60].max() < -0.3  # the middle of the rod, where photons hardly come through


def test_each_view_has_its_own_photons_and_many_change_next_to_nothing():
    transmission = np.full((2, 8, 8), 0.5, np.float32)
    found = integrals_of_photons(transmission, [1e2, 1e7])
    assert found[0] == pytest.approx(-np.log(0.505))
    assert found[1] == pytest.approx(-np.log(0.5), abs=1e-6)


@pytest.mark.parametrize(
    ("photons", "words"),
    [(0.0, "positive"), (np.nan, "positive"), ([1.0, 2.0, 3.0], "one for each of 2 views")],
)
def test_wrong_numbers_of_photons_are_refused(photons, words):
    with pytest.raises(InputError, match=words):
        integrals_of_photons(np.ones((2, 4, 4), np.float32), photons)
    with pytest.raises(InputError, match="2 axes"):
        integrals_of_photons(np.ones((4, 4), np.float32), 1e4)
