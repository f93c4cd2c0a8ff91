"""Polychromatic rays through metal: what is left of them without it, and derivatives."""

import numpy as np
import pytest

from twinct.specimen import material
from twinct.xray.implants import MetalModel
from twinct.xray.response import PhotonResponse
from twinct.xray.spectrum import PhotonSpectrum, attenuation

ENERGIES = np.linspace(30, 120, 10)
SPECTRUM = PhotonSpectrum(ENERGIES, np.exp(-(((ENERGIES - 60) / 25) ** 2)))
RESPONSE = PhotonResponse.integrating()
TISSUE, BONE = material("soft_tissue"), material("bone")
METALS = [material("titanium"), material("steel")]


def integral(paths):
    """-ln of the transmission behind (material, path) pairs."""
    weight = SPECTRUM.photons * RESPONSE.mean(ENERGIES)
    depth = sum(np.multiply.outer(path, attenuation(of, ENERGIES)) for of, path in paths)
    return -np.log(np.exp(-depth) @ weight / weight.sum())


TISSUES = np.array([0.0, 40.0, 150.0, 90.0])
BONES = np.array([0.0, 10.0, 30.0, 0.0])
LENGTHS = np.array([[4.0, 2.0, 0.0, 30.0], [0.0, 1.0, 5.0, 0.0]])


@pytest.mark.parametrize("energy", [70.0, None])
def test_metal_is_taken_out(energy):
    measured = integral([(TISSUE, TISSUES), (BONE, BONES), *zip(METALS, LENGTHS, strict=True)])
    model = MetalModel(SPECTRUM, RESPONSE, [TISSUE, BONE], METALS, energy)
    left, _ = model.without(measured, BONES, LENGTHS)
    if energy is None:
        expected = integral([(TISSUE, TISSUES), (BONE, BONES)])
    else:
        expected = TISSUE.mu_per_mm(energy) * TISSUES + BONE.mu_per_mm(energy) * BONES
    np.testing.assert_allclose(left, expected, atol=1e-5)  # 1e-4 mm of tissue


@pytest.mark.parametrize("energy", [70.0, None])
@pytest.mark.parametrize("materials", [[TISSUE], [TISSUE, BONE]])
def test_derivatives_are_those_of_finite_differences(energy, materials):
    model = MetalModel(SPECTRUM, RESPONSE, materials, METALS, energy)
    measured = integral([(TISSUE, TISSUES), *zip(METALS, LENGTHS, strict=True)]) + 0.05
    dense = BONES if len(materials) == 2 else None
    _, slopes = model.without(measured, dense, LENGTHS)
    for which in range(2):
        step = np.zeros_like(LENGTHS)
        step[which] = 0.01
        after, before = (model.without(measured, dense, LENGTHS + s * step)[0] for s in (1, -1))
        np.testing.assert_allclose(slopes[which], (after - before) / 0.02, rtol=2e-3)


def test_one_energy_is_a_difference():
    model = MetalModel(PhotonSpectrum.monochromatic(80.0), RESPONSE, [TISSUE], METALS[:1], 80.0)
    left, slopes = model.without(np.array([3.0]), None, np.array([[2.0]]))
    mu = METALS[0].mu_per_mm(80.0)
    assert left[0] == pytest.approx(3 - 2 * mu, abs=1e-6)
    assert slopes[0, 0] == pytest.approx(-mu, rel=1e-9)
