"""Noise power spectra of noise whose spectrum is known."""

import numpy as np
import pytest

from twinct.evaluation.nps import Nps, detrended, noise_power_spectrum

VOXEL = (0.8, 0.5, 0.5)
SIGMA = 0.3


def white(seed, shape=(48, 64, 64)):
    return SIGMA * np.random.default_rng(seed).standard_normal(shape)


def test_white_noise(figure) -> None:
    found = Nps.averaged([noise_power_spectrum(white(seed), VOXEL) for seed in range(40)])
    expected = SIGMA**2 * np.prod(VOXEL)
    modes = 40 * found.share * np.prod(np.array([48, 64, 64]) * VOXEL)
    sure = modes > 5000  # else chance alone, sqrt(2 / modes), would be a matter of some per cent
    off = np.abs(found.value / expected - 1)
    figure(f"NPS off by {off[sure].max():.3%}, integral by {found.variance / SIGMA**2 - 1:.3%}")
    assert sure.mean() > 0.8 and off[sure].max() < 0.03
    assert (off < 5 * np.sqrt(2 / modes)).all()
    assert found.variance == pytest.approx(SIGMA**2, rel=0.01)
    assert found.share.sum() == pytest.approx(1 / np.prod(VOXEL)), "all of frequency space"


def test_its_integral_is_the_mean_square_to_the_last_digits() -> None:
    noise, mask = white(1), np.random.default_rng(2).random((48, 64, 64)) > 0.4
    assert noise_power_spectrum(noise, VOXEL).variance == pytest.approx(
        (noise**2).mean(), rel=1e-12
    )
    masked = noise_power_spectrum(noise, VOXEL, mask)
    assert masked.variance == pytest.approx((noise[mask] ** 2).mean(), rel=1e-12)


def test_one_frequency_is_found_where_it_is() -> None:
    """A plane wave of 4 periods across 32 mm in 2-D: 1/8 per mm, power a^2 / 2."""
    y, x = np.mgrid[:64, :64] * 0.5
    found = noise_power_spectrum(2 * np.sin(2 * np.pi * x / 8), (0.5, 0.5))
    peak = found.value.argmax()
    assert found.frequency_per_mm[peak] == pytest.approx(1 / 8, abs=0.5 / 32)
    assert found.value[peak] * found.share[peak] == pytest.approx(2.0)
    assert found.mean_frequency_per_mm == pytest.approx(1 / 8, abs=0.5 / 32)


def test_a_trend_is_no_noise() -> None:
    noise = white(3, (24, 26, 28))
    z, y, x = np.indices(noise.shape) / 20
    mask = (z - 0.6) ** 2 + (y - 0.6) ** 2 + (x - 0.7) ** 2 < 0.3
    left = detrended(noise + 3 + 2 * z - y * x + x**2, mask)
    assert (left[~mask] == 0).all()
    np.testing.assert_allclose(left[mask], detrended(noise, mask)[mask], atol=1e-9)
    # Ten coefficients take ten degrees of freedom.
    assert left[mask].std() == pytest.approx(noise[mask].std(), rel=0.01)
    everywhere = detrended(noise + 3 + 2 * z)
    assert everywhere.std() == pytest.approx(noise.std(), rel=0.01)


def test_between_its_frequencies_and_near_zero() -> None:
    nps = Nps(np.array([0.0, 1.0, 2.0]), np.array([0.0, 4.0, 2.0]), np.ones(3))
    np.testing.assert_allclose(nps([0.0, 1.5, 9.0]), [4.0, 3.0, 2.0])
