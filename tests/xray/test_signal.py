"""Beer-Lambert over a spectrum, the free beam, and what it costs, against plain numpy."""

import numpy as np
import pytest
from scipy import integrate
from xray_scenes import random_view

from twinct.geometry import Panel, ScanGeometry
from twinct.specimen.materials import material
from twinct.xray.beam import fall_off
from twinct.xray.response import PhotonResponse
from twinct.xray.signal import Signal
from twinct.xray.spectrum import PhotonSpectrum

RELATIVE = 5e-6
"""Single precision: an exponent of 20 is known to 1e-6, a place in the table to 1e-3 of a node."""

ENERGIES = np.linspace(20, 120, 60)
SPECTRUM = PhotonSpectrum(ENERGIES, 1e3 * (130 - ENERGIES) * np.exp(-((25 / ENERGIES) ** 3)))


def truth(paths, materials, response):
    mus = np.array([[m.mu_per_mm(e) for e in ENERGIES] for m in materials])
    passed = np.exp(-np.einsum("mrc,me->rce", paths.astype(float), mus))
    return np.stack(
        [
            passed @ (SPECTRUM.photons * response.mean(ENERGIES)),
            passed @ (SPECTRUM.photons * response.square(ENERGIES)),
        ]
    )


@pytest.mark.parametrize(
    ("names", "longest_mm"),
    [(("bone",), (150,)), (("steel",), (25,)), (("bone", "titanium", "water"), (80, 10, 100))],
)
@pytest.mark.parametrize("kind", ["counting", "integrating", "scintillator"])
def test_signal_is_the_sum_over_the_spectrum(names, longest_mm, kind):
    materials = [material(name) for name in names]
    response = {
        "counting": PhotonResponse.counting(),
        "integrating": PhotonResponse.integrating(),
        "scintillator": PhotonResponse.scintillator(material("Cesium Iodide"), 0.3),
    }[kind]
    rng = np.random.default_rng(1)
    paths = np.stack([rng.uniform(0, x, (24, 40)) * rng.random((24, 40)) for x in longest_mm])
    paths[:, 0] = 0
    paths = paths.astype(np.float32)
    signal = Signal(SPECTRUM, materials, response)
    found = signal(paths, np.ones((24, 40), np.float32))
    np.testing.assert_allclose(found, truth(paths, materials, response), rtol=RELATIVE)
    np.testing.assert_allclose(found[:, 0, 0], signal.free, rtol=RELATIVE)


def test_paths_below_zero_of_a_reconstructed_volume_add_signal():
    water = material("water")
    paths = np.linspace(-20, 20, 24 * 40, dtype=np.float32).reshape(1, 24, 40)
    signal = Signal(SPECTRUM, [water], PhotonResponse.integrating())
    found = signal(paths, np.ones((24, 40), np.float32))
    np.testing.assert_allclose(
        found, truth(paths, [water], PhotonResponse.integrating()), rtol=RELATIVE
    )


@pytest.mark.parametrize("names", [("bone",), ("bone", "water")])
def test_a_pixel_is_the_mean_of_its_samples_each_with_its_own_beam(names):
    materials = [material(name) for name in names]
    rng = np.random.default_rng(2)
    paths = rng.uniform(0, 30, (len(names), 30, 45)).astype(np.float32)
    beam = rng.uniform(1, 2, (30, 45)).astype(np.float32)
    signal = Signal(SPECTRUM, materials, PhotonResponse.integrating())
    found = np.zeros((2, 10, 15), np.float32)
    signal.add(paths, beam, found, samples=3, share=0.25)
    signal.add(paths, beam, found, samples=3, share=0.75)
    single = truth(paths, materials, PhotonResponse.integrating()) * beam
    expected = single.reshape(2, 10, 3, 15, 3).mean(axis=(2, 4))
    np.testing.assert_allclose(found, expected, rtol=RELATIVE)


def test_beyond_the_table_the_signal_only_gets_smaller():
    signal = Signal(SPECTRUM, [material("bone")], PhotonResponse.counting())
    paths = np.array([[[1e3, 2e3, 1e5]]], np.float32)
    found = signal(paths, np.ones((1, 3), np.float32))[0, 0]
    assert (found >= 0).all()
    assert found[0] < 1e-9 * signal.free[0]


def test_fall_off_is_inverse_square_times_cosine():
    panel = Panel(9, 12, 20.0, 25.0)
    view = random_view(np.random.default_rng(3), panel, np.zeros(3))
    rays = view.pixel_centres(0) - view.source[0]
    r = np.linalg.norm(rays, axis=-1)
    cosine = -(rays @ view.normal[0]) / r
    np.testing.assert_allclose(fall_off(view), 1e6 * cosine / r**2, rtol=1e-6)
    fine = Panel(27, 36, 20 / 3, 25 / 3)
    same = ScanGeometry(view.source, view.detector, view.u, view.v, fine)
    np.testing.assert_array_equal(fall_off(view, 3), fall_off(same))


def test_the_panel_catches_the_photons_of_its_solid_angle():
    """Photons per mm^2 at 1 m are photons per microsteradian: their sum is the solid angle."""
    panel = Panel(200, 300, 1.0, 1.0)
    view = ScanGeometry([[0, 40, 300.0]], [[0, 0, 0.0]], [[1, 0, 0]], [[0, 1, 0]], panel)
    caught = fall_off(view).sum(dtype=float) * 1.0
    solid, _ = integrate.dblquad(
        lambda y, x: 300 / (x**2 + (y - 40) ** 2 + 300**2) ** 1.5, -150, 150, -100, 100
    )
    assert caught == pytest.approx(1e6 * solid, rel=1e-5)
