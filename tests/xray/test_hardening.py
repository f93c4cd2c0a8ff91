"""Beam hardening: what the model makes, its inverse undoes; cupping and streaks go."""

import numpy as np
import pytest

from twinct.geometry import Panel, ScanGeometry, VolumeGrid
from twinct.recon import Projector, sart
from twinct.scenario import Detector, Source
from twinct.specimen.materials import material
from twinct.xray.build import build_response, build_spectrum
from twinct.xray.hardening import Hardening
from twinct.xray.response import PhotonResponse
from twinct.xray.signal import Signal
from twinct.xray.spectrum import PhotonSpectrum

ENERGIES = np.linspace(20, 100, 41)
SPECTRUM = PhotonSpectrum(ENERGIES, (105 - ENERGIES) * np.exp(-((27 / ENERGIES) ** 3)))
RESPONSE = PhotonResponse.integrating()
WATER, BONE = material("water"), material("bone")
REFERENCE_KEV = 60.0


def polychromatic(water_mm, bone_mm=0.0):
    weight = SPECTRUM.photons * ENERGIES
    mus = [np.array([m.mu_per_mm(e) for e in ENERGIES]) for m in (WATER, BONE)]
    exponent = np.multiply.outer(water_mm, mus[0]) + np.multiply.outer(bone_mm, mus[1])
    return (-np.log(np.exp(-exponent) @ weight / weight.sum())).astype(np.float32)


def test_one_material_is_inverted_and_noise_below_zero_stays_noise():
    lengths = np.linspace(0, 400, 101)
    hardening = Hardening(SPECTRUM, RESPONSE, [WATER], REFERENCE_KEV)
    found = hardening.correct(polychromatic(lengths))
    np.testing.assert_allclose(found, lengths * WATER.mu_per_mm(REFERENCE_KEV), atol=2e-4)
    assert hardening.correct(np.float32([-0.02]))[0] == pytest.approx(-0.02, rel=0.2)


def test_two_materials_are_inverted():
    rng = np.random.default_rng(1)
    water, bone = rng.uniform(0, 200, (2, 500)) * [[1], [0.3]]
    hardening = Hardening(SPECTRUM, RESPONSE, [WATER, BONE], REFERENCE_KEV, bone.max())
    found = hardening.correct(polychromatic(water, bone), bone.astype(np.float32))
    mus = WATER.mu_per_mm(REFERENCE_KEV), BONE.mu_per_mm(REFERENCE_KEV)
    np.testing.assert_allclose(found, mus[0] * water + mus[1] * bone, atol=1e-3)


PANEL = Panel(3, 121, 2.0, 2.0)
GRID = VolumeGrid((3, 96, 96), 1.25)
RADIUS = 45.0
RODS = [(-25.0, 0.0), (25.0, 0.0)]
ROD_RADIUS = 8.0


def orbit(views=90):
    angle = np.linspace(0, 2 * np.pi, views, endpoint=False)
    out = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    u = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)
    return ScanGeometry(400 * out, -200 * out, u, np.tile([0.0, 0.0, 1.0], (views, 1)), PANEL)


def chords(geometry, centre, radius):
    """Path in an upright cylinder, (views, rows, columns), mm."""
    images = []
    for view in range(len(geometry)):
        rays = geometry.pixel_centres(view) - geometry.source[view]
        flat = rays[..., :2]
        length = np.linalg.norm(flat, axis=-1)
        to_axis = np.asarray(centre) - geometry.source[view, :2]
        offset = (flat[..., 0] * to_axis[1] - flat[..., 1] * to_axis[0]) / length
        inside = 2 * np.sqrt(np.maximum(radius**2 - offset**2, 0))
        images.append(inside * np.linalg.norm(rays, axis=-1) / length)
    return np.array(images)


def solve(integrals, geometry):
    return sart(Projector(geometry, GRID), integrals, iterations=5, relaxation=0.3).array[1]


FROM_AXIS_MM = 1.25 * np.hypot(*(np.indices(GRID.shape[1:]) - 47.5))


def cupping(volume):
    r = FROM_AXIS_MM
    edge, centre = volume[(r > 32) & (r < 40)].mean(), volume[r < 12].mean()
    return (edge - centre) / centre


def test_cupping_of_a_cylinder_goes(figure):
    geometry = orbit()
    integrals = polychromatic(0.0, chords(geometry, (0, 0), RADIUS))
    r = FROM_AXIS_MM
    before = solve(integrals, geometry)
    hardening = Hardening(SPECTRUM, RESPONSE, [BONE], REFERENCE_KEV)
    after = solve(hardening.correct(integrals), geometry)
    figure(f"cupping {cupping(before):.3f}, corrected {cupping(after):.4f}")
    assert cupping(before) > 0.05
    assert abs(cupping(after)) < 0.005
    assert after[r < 40].mean() == pytest.approx(BONE.mu_per_mm(REFERENCE_KEV), rel=0.01)


def physics(kvp=80.0, aluminium_mm=2.5, layer_mm=0.6):
    """Spectrum and detector as they are, but for what is given."""
    filters = [{"material": "aluminium", "thickness_mm": aluminium_mm}]
    tube = {"kind": "tube", "kvp": kvp, "filters": filters, "bins": 40}
    layer = {"kind": "scintillator", "thickness_mm": layer_mm}
    return build_spectrum(Source(spectrum=tube)), build_response(Detector(response=layer))


@pytest.mark.parametrize(
    ("wrong", "most"),
    [
        ({}, 0.005),
        ({"kvp": 84.0}, 0.01),
        ({"aluminium_mm": 3.0}, 0.01),
        ({"layer_mm": 0.7}, 0.01),
        ({"kvp": 84.0, "aluminium_mm": 3.0, "layer_mm": 0.7}, 0.02),
    ],
    ids=lambda of: " ".join(of) or "known" if isinstance(of, dict) else "",
)
def test_cupping_that_a_correction_with_another_spectrum_leaves(wrong, most, figure):
    """The image has one spectrum, filter and scintillator, the correction believes in others."""
    geometry = orbit()
    spectrum, response = physics()
    signal = Signal(spectrum, [BONE], response)
    chord = chords(geometry, (0, 0), RADIUS).astype(np.float32)
    seen = np.stack([signal(view[None], np.ones_like(view))[0] for view in chord])
    integrals = -np.log(seen / np.float32(signal.free[0]))
    before = cupping(solve(integrals, geometry))
    hardening = Hardening(*physics(**wrong), [BONE], REFERENCE_KEV)
    volume = solve(hardening.correct(integrals), geometry)
    left = cupping(volume)
    mean = volume[FROM_AXIS_MM < 40].mean() / BONE.mu_per_mm(REFERENCE_KEV) - 1
    figure(f"{wrong or 'known'}: cupping {before:.4f} to {left:.4f}, mean {mean:+.4f}")
    assert before > 0.05
    assert abs(left) < most
    # A wrong spectrum is a wrong scale first, and hardly a cup.
    assert abs(mean) < (0.1 if wrong else 0.01)


def test_the_dark_band_between_two_bones_goes(figure):
    geometry = orbit()
    bone = sum(chords(geometry, centre, ROD_RADIUS) for centre in RODS)
    water = chords(geometry, (0, 0), RADIUS) - bone
    integrals = polychromatic(water, bone)
    base = Hardening(SPECTRUM, RESPONSE, [WATER], REFERENCE_KEV)
    first = solve(base.correct(integrals), geometry)
    # The dense path as the pipeline makes it: from the first volume.
    low, high = WATER.mu_per_mm(REFERENCE_KEV), BONE.mu_per_mm(REFERENCE_KEV)
    share = np.clip(2 * (first - low) / (high - low) - 0.5, 0, 1)
    dense = Projector(geometry, GRID)(np.tile(share, (3, 1, 1)).astype(np.float32))
    both = Hardening(SPECTRUM, RESPONSE, [WATER, BONE], REFERENCE_KEV, dense.max())
    second = solve(
        np.stack([both.correct(*v) for v in zip(integrals, dense, strict=True)]), geometry
    )
    y, x = 1.25 * (np.indices(GRID.shape[1:]) - 47.5)
    between = (np.abs(x) < 10) & (np.abs(y) < 4)
    aside = (np.abs(x) < 10) & (np.abs(y) > 22) & (np.abs(y) < 30)
    bands = [abs(v[between].mean() - v[aside].mean()) / low for v in (first, second)]
    figure(f"band between the bones {bands[0]:.3f}, corrected {bands[1]:.4f}")
    assert bands[0] > 0.04
    assert bands[1] < 0.25 * bands[0]
