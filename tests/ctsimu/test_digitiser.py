"""Grey values, blur and sampling against formulas."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from twinct.core.errors import InputError
from twinct.core.files.images import RawImage
from twinct.ctsimu.digitiser import Digitiser
from twinct.ctsimu.sampling import sampling
from twinct.ctsimu.scene import FocalSpot, PanelResponse
from twinct.geometry import Panel
from twinct.xray.readout import binned

PLAIN = dict(
    real=False, scintillator=None, front=(), efficiency=None, imin=100.0, imax=50000.0,
    factor=None, offset=None, curve=None, bits=16, snr=None, noise=None, resolution_mm=0.0,
    mtf=None, lag=0.0, bad_pixels=None,
)  # fmt: skip


def detector(panel=None, **changes):
    return Digitiser(PanelResponse(**PLAIN | changes), panel or Panel(1, 4, 0.05, 0.05), 2e-9)


def test_three_ways_to_a_grey_value_and_their_precedence(tmp_path):
    energy = np.array([0.0, 1e-9, 2e-9, 3e-9])
    np.testing.assert_allclose(detector().grey(energy), [100, 25050, 50000, 74950])
    linear = detector(factor=1e13, offset=7.0)
    np.testing.assert_allclose(linear.grey(energy), [7, 10007, 20007, 30007])
    (tmp_path / "curve.tsv").write_text("0.0\t180\n# J, grey value\n1e-9,1000\n2e-9 1500\n")
    curve = detector(factor=1e13, offset=7.0, curve=tmp_path / "curve.tsv")
    np.testing.assert_allclose(curve.grey(energy), [180, 1000, 1500, 2000])
    assert detector(bits=12).stored(np.array([-3.0, 1.6, 1e6])).tolist() == [0, 2, 4095]


def test_table_that_does_not_rise_is_named(tmp_path):
    (tmp_path / "curve.tsv").write_text("1 2\n0 3\n")
    with pytest.raises(InputError, match="curve.tsv: the first column must rise"):
        detector(curve=tmp_path / "curve.tsv").grey(np.ones(1))


def test_noise_by_snr_and_by_file(tmp_path):
    quantum = detector(imin=0.0, snr=200.0).deviation(np.array([0.0, 12500.0, 50000.0]))
    np.testing.assert_allclose(quantum, [0, 125, 250])
    (tmp_path / "noise.tsv").write_text("0 10\n1000 100\n")
    filed = detector(noise=tmp_path / "noise.tsv", snr=200.0)
    np.testing.assert_allclose(filed.deviation(np.array([500.0, 1000.0])), [500 / 55, 10])
    assert detector().deviation(np.ones(1)) is None


def test_noise_has_the_deviation_of_the_file_and_the_texture_of_the_point_spread():
    panel = Panel(256, 256, 0.1, 0.1)
    white = detector(panel=panel).noise(np.random.default_rng(1))
    spread = detector(panel=panel, resolution_mm=0.25)
    coloured = spread.noise(np.random.default_rng(1))
    # 65536 pixels, of which a dozen share their noise: 1 / sqrt(2 * 65536 / 12) = 1 %.
    assert white.std() == pytest.approx(1, rel=0.01)
    assert coloured.std() == pytest.approx(1, rel=0.03)
    neighbours = np.mean(coloured[:, 1:] * coloured[:, :-1]) / coloured.var()
    expected = np.exp(-((panel.pitch_u / 2 / spread._sigma_mm()) ** 2))  # of a Gaussian
    assert neighbours == pytest.approx(expected, abs=0.02)
    assert abs(np.mean(white[:, 1:] * white[:, :-1])) < 0.02


@pytest.mark.parametrize("resolution_mm", [0.1, 0.15])
def test_wires_as_wide_as_the_basic_spatial_resolution_dip_by_20_percent(resolution_mm):
    # ISO 19232-5: two wires of that diameter, that far apart; thin, so their shadow is a chord.
    fine, pitch = 20, 0.05
    x = (np.arange(200 * fine) + 0.5) / fine * pitch - 100 * pitch
    wire = np.sqrt(np.clip(1 - (2 * (np.abs(x) - resolution_mm) / resolution_mm) ** 2, 0, None))
    # The point spread on a fine lattice, the pixel by averaging.
    panel = Panel(1, len(x), pitch / fine, pitch / fine)
    coarse = detector(panel=Panel(1, 200, pitch, pitch), resolution_mm=resolution_mm)
    sigma = coarse._sigma_mm() / panel.pitch_u
    shadow = gaussian_filter1d(wire, sigma)
    shadow = np.convolve(shadow, np.ones(fine) / fine, mode="same")
    dip = 1 - shadow[len(x) // 2] / shadow.max()
    assert dip == pytest.approx(0.20, abs=0.005)


def test_blur_keeps_a_flat_image_and_spreads_a_point_by_its_sigma():
    panel = Panel(64, 96, 0.1, 0.1)
    blurring = detector(panel=panel, resolution_mm=0.4)
    np.testing.assert_allclose(blurring.blurred(np.full(panel.shape, 3e-9)), 3e-9, rtol=1e-5)
    point = np.zeros(panel.shape)
    point[30, 40] = 1.0
    spread = blurring.blurred(point)
    columns = spread.sum(axis=0)
    variance = columns @ (np.arange(96) - 40.0) ** 2 * 0.1**2
    assert columns.sum() == pytest.approx(1.0, abs=1e-4)
    assert variance == pytest.approx(0.4**2 / 2 - 0.1**2 / 12, rel=1e-3)


def test_binning_is_the_mean_of_blocks():
    image = np.arange(24.0).reshape(4, 6)
    np.testing.assert_allclose(binned(image, 3, 2), [[4, 7], [16, 19]])


def test_point_source_is_sampled_on_one_even_lattice():
    plan = sampling(FocalSpot((0, 0), (0, 0), None), 6, 30, pixels=1000)
    assert plan.samples == 2 and len(plan.shift) == 9
    inner = (np.arange(2) + 0.5) / 2 - 0.5
    along = np.unique(np.round(plan.shift[:, :1] + inner, 9))
    np.testing.assert_allclose(along, (np.arange(6) + 0.5) / 6 - 0.5, atol=1e-9)


def test_gaussian_spot_has_its_mean_and_spread():
    plan = sampling(FocalSpot((0, 0), (0.008, 0.024), None), 3, 64, pixels=1000)
    np.testing.assert_allclose(plan.spot_mm.mean(axis=0), 0, atol=1e-15)
    # Strata stand for themselves by their means: 64 of them hold 98.6 % of the variance.
    np.testing.assert_allclose(plan.spot_mm.std(axis=0), [0.008, 0.024], rtol=0.01)
    # Every direction sees many points of it, and the pixel is covered evenly.
    for angle in np.linspace(0, np.pi, 7):
        seen = np.sort(plan.spot_mm @ [np.cos(angle), np.sin(angle)])
        assert np.diff(seen).max() < 0.03
    assert np.abs(plan.shift.mean(axis=0)).max() < 0.03


def test_image_spot_takes_its_mean_and_spread_from_the_image(tmp_path):
    weights = np.zeros((20, 40), "<f4")
    weights[5:10, 10:30] = 1.0  # row 0 at -v
    weights.tofile(tmp_path / "spot.raw")
    image = RawImage(tmp_path / "spot.raw", "<f4", 40, 20, 0)
    points = sampling(FocalSpot((0.4, 0.2), (0, 0), image), 3, 200, pixels=1000).spot_mm
    np.testing.assert_allclose(points.mean(axis=0), [0, -0.025], atol=1e-4)
    np.testing.assert_allclose(points.std(axis=0), [0.2 / 12**0.5, 0.05 / 12**0.5], rtol=0.01)
    with pytest.raises(InputError, match="spot.raw"):
        sampling(FocalSpot((1, 1), (0, 0), RawImage(image.path, "<f4", 41, 20, 0)), 3, 9, pixels=9)
