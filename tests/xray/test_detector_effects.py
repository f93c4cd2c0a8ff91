"""Noise, point spread, readout and correction, each against its statistics or its formula."""

import numpy as np
import pytest
from scipy import special

from twinct.core.errors import InputError
from twinct.xray.noise import normal_noise, quantum_noise
from twinct.xray.readout import Amplifier, correct, mend_bad_pixels
from twinct.xray.spread import CUT_OFF, PointSpreadFunction

N = 400 * 500
"""Pixels of a uniform image: its variance is known to sqrt(2 / N) = 0.3 %."""
SPREAD_OF_VARIANCE = 5 * np.sqrt(2 / N)
"""Five standard deviations."""


def uniform(value):
    return np.full((400, 500), value, np.float32)


@pytest.mark.parametrize("photons", [3.0, 250.0, 40000.0])
def test_counted_photons_are_poisson(photons):
    image = quantum_noise(uniform(photons), uniform(photons), np.random.default_rng(1))
    assert (image == np.round(image)).all()
    assert image.mean() == pytest.approx(photons, rel=5 / np.sqrt(N * photons))
    # Kurtosis 1/photons widens the spread of the variance of few photons.
    tolerance = SPREAD_OF_VARIANCE * np.sqrt(1 + 1 / (2 * photons))
    assert image.var() == pytest.approx(photons, rel=tolerance)


def test_energy_integration_has_the_noise_of_its_compound_sum():
    """Against photons drawn one by one from two energies."""
    energies, counts = np.array([30.0, 100.0]), np.array([40.0, 25.0])
    rng = np.random.default_rng(2)
    drawn = rng.poisson(counts, (N, 2)) @ energies
    mean, square = counts @ energies, counts @ energies**2
    image = quantum_noise(uniform(mean), uniform(square), np.random.default_rng(3))
    assert image.mean() == pytest.approx(drawn.mean(), rel=0.002)
    assert image.var() == pytest.approx(drawn.var(), rel=2 * SPREAD_OF_VARIANCE)
    assert image.min() >= 0


def test_darkness_has_no_quantum_noise_and_a_seed_gives_the_same_image():
    dark = uniform(0)
    assert (quantum_noise(dark, dark, np.random.default_rng(1)) == 0).all()
    a, b, c = (normal_noise(dark, 2.0, np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert np.array_equal(a, b)
    assert not np.array_equal(a, c)
    assert a.std() == pytest.approx(2.0, rel=SPREAD_OF_VARIANCE)


@pytest.mark.parametrize("sigma_mm", [0.1, 0.2, 0.45])
def test_an_edge_spreads_like_the_error_function(sigma_mm):
    """On the mean over where the edge lies inside a pixel: one edge for itself is aliased."""
    pitch = 0.1
    x = (np.arange(400) - 199.5) * pitch
    spread = PointSpreadFunction.gaussian(sigma_mm)

    def integral(t):
        """Integral of the spread edge up to t."""
        z = t / sigma_mm
        return sigma_mm * (z * special.ndtr(z) + np.exp(-(z**2) / 2) / np.sqrt(2 * np.pi))

    differences = []
    for place in (np.arange(20) + 0.5) / 20 * pitch:
        share = np.clip((x - place) / pitch + 0.5, 0, 1)  # what the edge leaves of each pixel
        found = spread.apply(np.tile(share, (2, 1)).astype(np.float32), pitch, pitch)[0]
        expected = (integral(x - place + pitch / 2) - integral(x - place - pitch / 2)) / pitch
        differences.append(found - expected)
    inner = slice(60, -60)
    assert (
        np.abs(np.mean(differences, axis=0)[inner]).max() < 3e-3
    )  # at one pixel the MTF is cut at 0.7 %


def overshoot(spread, pitch):
    """Of an edge that lies between two pixels."""
    edge = np.repeat(np.array([0, 1], np.float32), 100)
    return float(spread.apply(np.tile(edge, (4, 1)), pitch, pitch)[0, 50:150].max()) - 1


def gaussian_table(sigma_mm, end_per_mm):
    frequencies = np.linspace(0, end_per_mm, 401)
    return PointSpreadFunction.tabulated(
        frequencies, np.exp(-2 * (np.pi * sigma_mm * frequencies) ** 2)
    )


@pytest.mark.parametrize(
    ("sigma_px", "most"), [(0.3, 0.014), (0.4, 0.014), (0.5, 0.014), (0.8, 1e-3), (1.2, 1e-4)]
)
def test_an_edge_overshoots_where_the_spread_is_narrower_than_a_pixel(sigma_px, most):
    """What whole pixels cannot show is cut off at their Nyquist frequency, whatever the kind."""
    found = overshoot(PointSpreadFunction.gaussian(0.2 * sigma_px), 0.2)
    assert found < most
    if sigma_px <= 0.5:
        assert found > 0.01
    table = gaussian_table(0.2 * sigma_px, 10.0)
    assert overshoot(table, 0.2) == pytest.approx(found, abs=2e-4)
    # Physical pixels of a quarter show it.
    assert overshoot(PointSpreadFunction.gaussian(0.2 * sigma_px), 0.05) < 1e-4


def test_a_table_may_end_where_it_hardly_matters():
    for modulation, most in ((0.99 * CUT_OFF, 0.004), (0.01, 0.0004)):
        end = np.sqrt(-np.log(modulation) / 2) / (np.pi * 0.5)
        table = gaussian_table(0.5, end)
        assert overshoot(table, 0.1) < most
        table.check_end(0.1)
    broken = gaussian_table(0.5, np.sqrt(-np.log(0.5) / 2) / (np.pi * 0.5))
    assert overshoot(broken, 0.1) > 0.03
    with pytest.raises(InputError, match="Nyquist"):
        broken.check_end(0.1)


def test_a_line_spreads_by_its_sigma_along_either_axis():
    line = np.zeros((101, 151), np.float32)
    line[50, 75] = 1
    spread = PointSpreadFunction.gaussian(0.3).apply(line, 0.1, 0.2)
    assert spread.sum(dtype=float) == pytest.approx(1, rel=1e-5)
    rows, columns = np.indices(line.shape)
    assert np.sqrt((spread * ((columns - 75) * 0.1) ** 2).sum()) == pytest.approx(0.3, rel=1e-3)
    assert np.sqrt((spread * ((rows - 50) * 0.2) ** 2).sum()) == pytest.approx(0.3, rel=1e-3)


def test_an_mtf_scales_a_wave():
    spread = PointSpreadFunction.tabulated(np.array([0.0, 1.0, 5.0]), np.array([1.0, 0.6, 0.0]))
    x = np.arange(800) * 0.1
    wave = np.tile(1 + 0.5 * np.cos(2 * np.pi * 1.0 * x), (3, 1)).astype(np.float32)
    out = spread.apply(wave, 0.1, 0.1)[1, 200:600]
    np.testing.assert_allclose(out, 1 + 0.3 * np.cos(2 * np.pi * x[200:600]), atol=2e-3)


def test_readout_quantises_and_saturates():
    signal = np.array([[0.0, 1.4, 100.0, 1e6, -5.0]], np.float32)
    np.testing.assert_allclose(Amplifier(2.0, 10.0).read(signal), [[10, 12.8, 210, 2000010, 0]])
    assert Amplifier(2.0, 10.0, bits=12).read(signal).tolist() == [[10, 13, 210, 4095, 0]]
    assert Amplifier(2.0, 10.0, bits=12, saturation=200).read(signal).max() == 200


def test_correction_gives_transmission_and_a_finite_log_where_no_light_came():
    flat, dark = np.full((2, 3), 1100, np.float32), np.full((2, 3), 100, np.float32)
    raw = np.array([[1100, 600, 101], [100, 60, 0]], np.float32)
    out = correct(raw, flat, dark)
    np.testing.assert_allclose(out, [[1, 0.5, 1e-3], [5e-4] * 3], rtol=1e-6)
    assert np.isfinite(np.log(out)).all()


def test_bad_pixels_take_the_mean_of_their_neighbours():
    rows, columns = np.indices((9, 11))
    image = (3 * rows + 2 * columns).astype(np.float32)
    bad = np.zeros(image.shape, bool)
    bad[4, 5] = bad[1:3, 2:4] = bad[0, 0] = True
    broken = np.where(bad, np.float32(0), image)
    mended = mend_bad_pixels(broken, bad)
    assert mended[4, 5] == pytest.approx(image[4, 5])
    assert np.abs(mended - image)[bad].max() <= 5
    assert np.array_equal(mended[~bad], image[~bad])
