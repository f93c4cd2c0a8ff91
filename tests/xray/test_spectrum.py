"""Spectra: files, filters, and the tube against SpekPy's own air kerma and half value layer."""

import numpy as np
import pytest
from scipy import interpolate

from twinct.core.errors import InputError
from twinct.specimen.materials import material
from twinct.xray.response import PhotonResponse
from twinct.xray.spectrum import PhotonSpectrum
from twinct.xray.spread import PointSpreadFunction
from twinct.xray.tube import tube_spectrum


def mean_energy_kev(spectrum):
    return spectrum.photons @ spectrum.energies_kev / spectrum.total


def test_a_filter_attenuates_each_energy_and_rebinning_keeps_photons_and_energy():
    energies = np.arange(10.0, 121.0)
    spectrum = PhotonSpectrum(energies, np.exp(-((energies - 50) ** 2) / 900))
    copper = material("Cu")
    behind = spectrum.filtered(copper, 0.3)
    np.testing.assert_allclose(
        behind.photons, spectrum.photons * [np.exp(-0.3 * copper.mu_per_mm(e)) for e in energies]
    )
    coarse = behind.rebinned(20)
    assert len(coarse.energies_kev) <= 20
    assert coarse.total == pytest.approx(behind.total, rel=1e-12)
    assert mean_energy_kev(coarse) == pytest.approx(mean_energy_kev(behind), rel=1e-12)
    assert behind.rebinned(500) is behind


# NIST's mass energy-absorption coefficients of dry air (NISTIR 5632), keV and cm2/g.
NIST_KEV = [10, 15, 20, 30, 40, 50, 60, 80, 100]
NIST_CM2_G = [4.742, 1.334, 0.5389, 0.1537, 0.06833, 0.04098, 0.03041, 0.02407, 0.02325]


def air_kerma(spectrum):
    """uGy for each mAs at 1 m."""
    log_mu = interpolate.CubicSpline(np.log(NIST_KEV), np.log(NIST_CM2_G))
    energies = spectrum.energies_kev
    kev_per_g = 100 * (spectrum.photons * energies * np.exp(log_mu(np.log(energies)))).sum()
    return 1.602177e-16 * 1e3 * 1e6 * kev_per_g


def test_a_tube_gives_the_kerma_and_the_half_value_layer_that_spekpy_states():
    spekpy = pytest.importorskip("spekpy")
    own = spekpy.Spek(kvp=100, th=15, dk=0.5, mas=1, z=100).filter("Al", 2.5)
    spectrum = tube_spectrum(100, 15, step_kev=0.5).filtered(material("aluminium"), 2.5)
    assert spectrum.absolute
    # xraylib and SpekPy take their attenuation from different tables: 0.5 % of a filter's effect.
    assert spectrum.total == pytest.approx(own.get_flu() / 100, rel=0.01)
    assert mean_energy_kev(spectrum) == pytest.approx(own.get_emean(), rel=0.003)
    assert air_kerma(spectrum) == pytest.approx(own.get_kerma(), rel=0.015)
    half = spectrum.filtered(material("aluminium"), own.get_hvl1())
    assert air_kerma(half) / air_kerma(spectrum) == pytest.approx(0.5, abs=0.005)


def test_files_are_read_and_what_is_wrong_with_them_is_said(tmp_path):
    file = tmp_path / "tube.tsv"
    file.write_text("# keV photons\n0 0\n20,1e5\n30\t3e5\n40 0\n")
    spectrum = PhotonSpectrum.read(file)
    np.testing.assert_array_equal(spectrum.energies_kev, [20, 30])
    assert not spectrum.absolute
    assert spectrum.scaled(100).photons.tolist() == [25, 75]
    for text, reason in [
        ("20 1\n10 2\n", "must rise"),
        ("20 -1\n30 2\n", "not be negative"),
        ("20 x\n", "1: expected 2 columns"),
        ("0 1\n20 1\n", "must be positive"),
    ]:
        file.write_text(text)
        with pytest.raises(InputError, match=f"tube.tsv.*{reason}"):
            PhotonSpectrum.read(file)
    with pytest.raises(InputError, match="no_such"):
        PointSpreadFunction.read(tmp_path / "no_such")
    file.write_text("1 0.9\n2 0.5\n")
    with pytest.raises(InputError, match="frequency 0"):
        PointSpreadFunction.read(file)
    file.write_text("10 0.5\n20 1.5\n")
    with pytest.raises(InputError, match="between 0 and 1"):
        PhotonResponse.read_efficiency(file)


def test_a_tube_out_of_spekpys_range_is_refused():
    with pytest.raises(InputError, match="5000 kV"):
        tube_spectrum(5000)


def test_a_scintillator_absorbs_what_it_attenuates():
    caesium_iodide = material("Cesium Iodide")
    mean = PhotonResponse.scintillator(caesium_iodide, 0.2).mean(np.array([50.0]))
    assert mean[0] == pytest.approx(50 * (1 - np.exp(-0.2 * caesium_iodide.mu_per_mm(50))))
    behind = PhotonResponse.counting().behind(material("Al"), 1.0)
    assert behind.mean(np.array([30.0]))[0] == pytest.approx(np.exp(-material("Al").mu_per_mm(30)))
