"""Contrast and detectability of a disc in white noise, against the formulas."""

import math

import numpy as np
import pytest

from twinct.evaluation.contrast import contrast
from twinct.evaluation.nps import Nps, noise_power_spectrum
from twinct.evaluation.observer import detectability

SIGMA, HEIGHT, PIXEL = 0.2, 0.5, (0.4, 0.4)


@pytest.fixture(scope="module")
def disc():
    y, x = np.indices((128, 128)) - 63.5
    return HEIGHT * (np.hypot(x, y) < 20)


def noise(seed, shape=(128, 128)):
    return SIGMA * np.random.default_rng(seed).standard_normal(shape)


def test_contrast_to_noise_of_a_disc_in_white_noise(disc, figure) -> None:
    image, inside = disc + noise(0) + 1, disc > 0
    found = contrast(image[inside], image[~inside], disc[inside], disc[~inside], 2.0)
    figure(f"CNR {found.cnr:.4f}, {HEIGHT / SIGMA} expected")
    assert found.cnr == pytest.approx(HEIGHT / SIGMA, rel=0.03)
    assert found.contrast_rel == pytest.approx(HEIGHT / 2, rel=0.03)
    assert found.recovery == pytest.approx(1, rel=0.03)


def test_structure_of_the_truth_is_no_noise() -> None:
    true = np.linspace(0, 1, 1000)
    found = contrast(np.full(100, 2.0), true + noise(1, 1000), np.full(100, 2.0), true, 1.0)
    assert found.cnr == pytest.approx(1.5 / SIGMA, rel=0.06)
    nothing = contrast(np.ones(5), np.ones(5), np.ones(5), np.ones(5), 1.0)
    assert math.isnan(nothing.cnr) and math.isnan(nothing.recovery)


def test_detectability_of_a_disc_in_white_noise(disc, figure) -> None:
    expected = HEIGHT * math.sqrt(np.count_nonzero(disc)) / SIGMA
    exact = detectability(disc, PIXEL, SIGMA**2 * math.prod(PIXEL))
    assert exact == pytest.approx(expected, rel=1e-12)
    measured = Nps.averaged([noise_power_spectrum(noise(s), PIXEL) for s in range(200)])
    found = detectability(disc, PIXEL, measured)
    figure(f"d' {found:.3f}, {expected:.3f} expected")
    assert found == pytest.approx(expected, rel=0.03)


def test_blur_and_coloured_noise_against_the_observer_itself(disc, figure) -> None:
    """Templates applied to images: d' is the difference of the responses over their spread."""
    f = np.hypot(*np.meshgrid(*[np.fft.fftfreq(128, 0.4)] * 2, indexing="ij"))
    transfer, colour = np.exp(-((f / 0.5) ** 2)), 0.2 + f
    seen = np.fft.ifft2(np.fft.fft2(disc) * transfer).real
    responses = [
        float((seen * np.fft.ifft2(np.fft.fft2(noise(100 + s)) * colour).real).sum())
        for s in range(1500)
    ]
    empirical = float((seen**2).sum()) / np.std(responses)
    power = SIGMA**2 * math.prod(PIXEL) * colour**2
    found = detectability(disc, PIXEL, power, transfer)
    figure(f"d' {found:.3f}, {empirical:.3f} of the observer")
    # A standard deviation of 1500 draws is known to 1.8 %.
    assert found == pytest.approx(empirical, rel=0.055)


def test_without_noise_nothing_is_missed(disc) -> None:
    assert detectability(disc, PIXEL, 0.0) == math.inf
