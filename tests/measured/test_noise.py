"""Noise of measured scans: photons of the free beam, from pairs of flat images, or as stated."""

from __future__ import annotations

import numpy as np
import pytest
import scipy
from ball_scan import PITCH, SDD, SOD

from twinct.core.errors import InputError, ScenarioError
from twinct.measured.description import Images
from twinct.measured.noise import noise_of_flats
from twinct.scenario import load_scenario

PHOTONS = 3000.0
"""Of a pixel in air, in the views."""
SHAPE = (120, 160)
VIEWS = 12
KNOWN = 0.12
"""The sum of the covariances of 4 pairs of this panel is known to 5 %; seeds are fixed."""

BLUR = np.outer([0.25, 0.5, 0.25], [0.25, 0.5, 0.25])
"""Kernel of a detector's blur; its squares sum up to 0.375^2."""
GAIN = 0.375


def counts(rng, mean, blur=True, offset=100.0):
    """Return an image of a detector: photons, its blur, and its dark level."""
    drawn = rng.poisson(mean).astype(np.float64)
    return offset + (scipy.ndimage.convolve(drawn, BLUR, mode="wrap") if blur else drawn)


def beam():
    rows, columns = np.indices(SHAPE)
    return np.exp(-((rows - 60) ** 2 + (columns - 80) ** 2) / 120**2)


@pytest.fixture
def flats(tmp_path):
    """A function that stores flats of some photons, and returns the keys of ``images``."""

    def save(photons=PHOTONS, frames=8, blur=True, seed=1):
        rng = np.random.default_rng(seed)
        light = photons * beam() / np.median(beam())
        # The tube drifts, and each flat has a hit of the detector.
        drift = np.linspace(1, 1.03, frames)
        images = np.array([counts(rng, share * light, blur) for share in drift])
        images[:, 7, 9] *= 3
        np.save(tmp_path / "flats.npy", images)
        return {"flats": [{"path": str(tmp_path / "flats.npy")}], "black": 100.0}

    return save


def section(**keys):
    return Images.model_validate({"path": "views.npy", "values": "intensities", **keys})


@pytest.mark.parametrize("blur", [False, True])
def test_flats_tell_the_photons_that_blur_hides(flats, blur):
    gain = GAIN if blur else 1.0
    for seed in range(3):
        found = noise_of_flats(section(**flats(blur=blur, seed=seed)), lambda _: 100.0, np.asarray)
        assert found.pairs == 4
        assert found.gain == pytest.approx(gain, rel=KNOWN)
        assert (found.snr * found.gain) ** 2 == pytest.approx(PHOTONS, rel=KNOWN)
        # A pixel by itself seems to have seven times the photons.
        assert found.snr**2 == pytest.approx(PHOTONS / gain**2, rel=0.04)


@pytest.mark.parametrize("frames", [1, "equal"])
def test_flats_that_show_no_noise_tell_nothing(flats, frames, tmp_path):
    keys = flats(frames=2 if frames == "equal" else 1)
    if frames == "equal":
        one = np.load(tmp_path / "flats.npy")[0]
        np.save(tmp_path / "flats.npy", np.stack([one, one]))
    assert noise_of_flats(section(**keys), lambda _: 100.0, np.asarray) is None


@pytest.fixture
def imported_views(flats, stored, imported):
    """A function that imports views with air around a soft object, with flats of an exposure."""
    rng = np.random.default_rng(5)
    rows, columns = np.indices(SHAPE)
    light = PHOTONS * beam() / np.median(beam())
    views = []
    for view in range(VIEWS):
        shift = 10 * np.sin(2 * np.pi * view / VIEWS)
        p = 2 * np.exp(-((rows - 60) ** 2 + (columns - 80 - shift) ** 2) / 25**2)
        views.append(counts(rng, light * np.exp(-p)))
    circle = {"kind": "circle", "sod_mm": SOD, "sdd_mm": SDD, "pitch_mm": PITCH / 4}
    circle |= {"angles": {"step": 360 / VIEWS}, "rotates": "source"}
    circle |= {"direction": "counterclockwise", "rows": "up"}

    def run(scenario=None, photons=PHOTONS, **keys):
        images = stored(np.array(views), "intensities", **flats(photons), **keys)
        return imported({"images": images, "geometry": circle, "scenario": scenario or {}})

    return run


def test_a_scan_has_the_photons_of_its_flats(imported_views):
    scan, told = imported_views()
    assert scan.photons == pytest.approx(np.full(VIEWS, PHOTONS), rel=KNOWN)
    assert "from 4 pairs of flats" in "\n".join(told.notes)
    part = imported_views(bin=2)[0]
    assert part.photons == pytest.approx(4 * scan.photons, rel=KNOWN)


def test_flats_of_another_exposure_count_as_bright_as_the_views(imported_views):
    """Twice the exposure: air of the views reads one half, and has half of the photons."""
    scan, _ = imported_views(photons=2 * PHOTONS, air="auto")
    assert scan.photons == pytest.approx(np.full(VIEWS, PHOTONS), rel=KNOWN)


def test_stated_noise_counts(imported_views):
    stated = {"detector": {"noise": {"kind": "snr", "snr": 50.0, "gain": 0.5}}}
    scan, told = imported_views(stated)
    assert scan.photons == pytest.approx(np.full(VIEWS, 25.0**2))
    assert (
        "ratio of 50, as stated; means of many pixels have the noise of 625 photons"
        in "\n".join(told.notes)
    )


def test_noise_that_cannot_be_is_refused(imported_views):
    with pytest.raises(InputError, match="quantum noise is simulated; a measured scan has kind: s"):
        imported_views({"detector": {"noise": {"kind": "quantum"}}})
    with pytest.raises(ScenarioError, match=r"noise.gain is 0.5, but a simulated scan has 1"):
        load_scenario("scenarios/demo.yaml", ["detector.noise={kind: snr, snr: 9, gain: 0.5}"])
