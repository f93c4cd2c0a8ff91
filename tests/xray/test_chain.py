"""A scenario's source and detector, as images of the imager."""

import sys

import numpy as np
import pytest
from posed import posed
from xray_scenes import box, front_view, sphere

from twinct.core.errors import InputError, ScenarioError
from twinct.geometry import Pose, ScanGeometry
from twinct.scenario import (
    Correction,
    Detector,
    GaussianSpread,
    QuantumNoise,
    RandomBadPixels,
    Readout,
    SnrNoise,
    Source,
    TubeSpectrum,
    parse_scenario,
)
from twinct.specimen import BuiltPart, BuiltSpecimen
from twinct.specimen.materials import material
from twinct.xray import Imager
from twinct.xray.build import build_spectrum, effective_energy_kev
from twinct.xray.photons import free_photons

PANEL = {"columns": 160, "rows": 120, "pixel_pitch_mm": 1.5}
VIEW = front_view(Detector(**PANEL).panel)
HERE = posed(VIEW)
FREE = np.s_[:, :30]
"""Columns that the specimen does not shade."""
SCATTER = {"kind": "monte_carlo", "photons": 50_000, "voxel_mm": 2.5, "pixel_mm": 60.0}
PHOTONS = 4.0e5
"""Per mm^2 at 1 m and mAs: 25 in a pixel at 10 mAs and 600 mm would be 2.5e7."""

LAG_SHARE, LAG_CORRELATION = 0.06, 0.09
"""Of 3600 pixels, of which a dozen share their noise behind a point spread: 5 deviations of
1 / sqrt(3600 * 2) and 1 / sqrt(3600) would be 6 and 8 %."""


def skull_of_two(mesh=None):
    mesh = sphere((0, 20, 0), 25, 5) if mesh is None else mesh
    return BuiltSpecimen((BuiltPart("ball", material("bone"), mesh),), Pose.identity())


def image(detector=None, source=None, view=0, specimen=None, **options):
    detector = Detector(**PANEL, **(detector or {}))
    with Imager(
        Source(**(source or {})), detector, specimen or skull_of_two(), commanded=VIEW, **options
    ) as imager:
        return imager.render(VIEW, Pose.identity(), view)


def frame(detector, source=None, view=0, **options):
    with Imager(
        Source(**(source or {})),
        Detector(**PANEL, **detector),
        skull_of_two(),
        commanded=VIEW,
        **options,
    ) as imager:
        return imager.frame(HERE, view)


def test_an_ideal_chain_gives_what_gvxr_gives():
    ideal = image()
    # Bits enough that nothing is lost: the same image by path lengths, flat and dark images.
    by_paths = image({"readout": Readout(bits=None)})
    assert np.abs(by_paths - ideal).max() < 1e-5
    assert ideal.min() < 0.2


def test_a_spectrum_hardens():
    tube = {"spectrum": TubeSpectrum(kind="tube", kvp=100)}
    hard = image(source=tube)
    assert hard[FREE].min() > 1 - 1e-5
    spectrum = build_spectrum(Source(**tube))
    mu = [material("bone").mu_per_mm(e) for e in spectrum.energies_kev]
    weight = spectrum.photons * spectrum.energies_kev
    # The ray through the middle of the ball.
    row, column = np.unravel_index(hard.argmin(), hard.shape)
    expected = weight @ np.exp(-50 * np.array(mu)) / weight.sum()
    assert hard[row, column] == pytest.approx(expected, rel=0.01)
    assert effective_energy_kev(Source(**tube), Detector()) == pytest.approx(
        weight @ spectrum.energies_kev / weight.sum()
    )


def test_quantum_noise_follows_the_photon_number():
    source = {"photons_per_mm2_mas": PHOTONS, "current_ma": 2.0, "exposure_ms": 5.0}
    counting = {"response": {"kind": "counting"}, "noise": QuantumNoise(kind="quantum")}
    noisy, quiet = image(counting, source), image({"readout": Readout(bits=None)})
    photons = PHOTONS * 0.01 * 1.5**2 / 0.6**2
    ratio = (noisy - quiet)[FREE]
    # cos^3 of up to 13 degrees takes 4 % of the photons at the edge of that part.
    assert 1 / ratio.var() == pytest.approx(photons, rel=0.08)
    behind = quiet < 0.3
    expected = np.mean(1 / (photons * quiet[behind]))
    assert ((noisy - quiet) / quiet)[behind].var() == pytest.approx(expected, rel=0.15)


@pytest.mark.parametrize("binning", [1, 2])
def test_a_given_snr_is_the_snr_of_the_free_beam(binning):
    found = frame({"noise": SnrNoise(kind="snr", snr=100), "binning": binning})
    free = (found.raw / found.flat)[50:70, :30]
    assert free.mean() / free.std() == pytest.approx(100, rel=0.08)
    found = frame(
        {
            "noise": SnrNoise(kind="snr", snr=100),
            "point_spread": GaussianSpread(kind="gaussian", sigma_mm=3),
        }
    )
    free = (found.raw / found.flat)[50:70, :30]
    assert free.mean() / free.std() == pytest.approx(100, rel=0.08)


@pytest.mark.parametrize(
    ("noise", "spread"),
    [
        (QuantumNoise(kind="quantum"), None),
        (QuantumNoise(kind="quantum"), GaussianSpread(kind="gaussian", sigma_mm=1.5)),
        (SnrNoise(kind="snr", snr=60), None),
    ],
)
def test_lag_carries_the_noise_of_the_view_before_on(noise, spread):
    """Of (1 - l) s_k + l s_(k-1): deviation sqrt((1 - l)^2 + l^2), correlation l (1 - l) of it."""
    lag = 0.3
    source = Source(photons_per_mm2_mas=PHOTONS, current_ma=2.0, exposure_ms=5.0)

    def noises(**more):
        """Of views 3 and 4, each as a share of the free beam."""
        detector = Detector(**PANEL, noise=noise, point_spread=spread, **more)
        with Imager(source, detector, skull_of_two(), commanded=VIEW) as imager:
            frames = [imager.frame(HERE, view, HERE) for view in (3, 4)]
        return [(frame.raw / frame.flat)[FREE] - 1 for frame in frames]

    alone, then = noises(lag=lag)
    single, _ = noises()
    share = (1 - lag) ** 2 + lag**2
    assert alone.std() / single.std() == pytest.approx(np.sqrt(share), rel=LAG_SHARE)
    found = np.mean(alone * then) / (alone.std() * then.std())
    assert found == pytest.approx(lag * (1 - lag) / share, abs=LAG_CORRELATION)


def test_readout_noise_does_not_lag():
    detector = Detector(**PANEL, lag=0.3, readout=Readout(electronic_noise=50, bits=None))
    with Imager(Source(), detector, skull_of_two(), commanded=VIEW) as imager:
        one, other = (imager.frame(HERE, view, HERE) for view in (3, 4))
    first, second = ((frame.raw - frame.flat)[FREE] for frame in (one, other))
    assert first.std() == pytest.approx(50, rel=LAG_SHARE)
    assert abs(np.mean(first * second)) < LAG_CORRELATION * 50**2


@pytest.mark.parametrize("frames", [1, 4])
def test_lag_takes_noise_from_a_mean_of_flat_frames(frames):
    """The first of them shares its noise with one before, the last keeps some of its own back."""
    lag = 0.3

    def flat(lag, frames):
        sections = {
            "noise": SnrNoise(kind="snr", snr=100),
            "correction": Correction(flat_frames=frames),
        }
        return frame({**sections, "lag": lag}).flat

    share = (frames - 1 + (1 - lag) ** 2 + lag**2) / frames
    without = flat(0, 0)
    ratio = (flat(lag, frames) - without).std() / (flat(0, frames) - without).std()
    assert ratio == pytest.approx(np.sqrt(share), rel=1e-3)  # of one pattern


def test_noise_is_keyed_by_seed_and_view():
    noise = {"noise": SnrNoise(kind="snr", snr=50)}
    first = image(noise, view=3, seed=1)
    assert np.array_equal(first, image(noise, view=3, seed=1))
    assert not np.array_equal(first, image(noise, view=4, seed=1))
    assert not np.array_equal(first, image(noise, view=3, seed=2))


def test_grey_values_are_what_the_converter_gives():
    readout = Readout(free_beam=3000, offset=100, bits=12, electronic_noise=5)
    found = frame({"readout": readout})
    assert (found.raw == np.round(found.raw)).all()
    assert found.raw.max() <= 4095
    middle = found.flat[59:61, 79:81]
    assert middle == pytest.approx(3100, rel=1e-4)
    assert (found.dark == 100).all()
    assert (found.raw - found.flat)[FREE].std() == pytest.approx(5, rel=0.1)
    assert found.transmission.min() > 0
    assert (found.transmission - image())[FREE].std() == pytest.approx(5 / 3000, rel=0.15)


def test_flat_noise_is_the_same_in_every_view_and_falls_with_the_frames():
    def flats(frames):
        sections = {
            "noise": SnrNoise(kind="snr", snr=100),
            "correction": Correction(flat_frames=frames),
        }
        return frame(sections, view=0).flat, frame(sections, view=1).flat

    smooth, _ = flats(0)
    one, same = flats(4)
    assert np.array_equal(one, same)
    assert (one / smooth)[50:70].std() == pytest.approx(0.01 / 2, rel=0.05)


def moved(view, distance_mm):
    """The same view with its source nearer to the panel."""
    source = view.source - [[distance_mm, 0, 0]]
    return ScanGeometry(source, view.detector, view.u, view.v, view.panel)


def one_after_the_other(*views):
    names = ("source", "detector", "u", "v")
    arrays = (np.vstack([getattr(view, name) for view in views]) for name in names)
    return ScanGeometry(*arrays, VIEW.panel)


@pytest.mark.parametrize("binning", [1, 2])
def test_a_flat_image_is_scaled_to_where_a_view_was_commanded_to_be(binning):
    """What the arms miss by stays in the image: no machine has a flat image of every view."""
    to = moved(VIEW, 40)
    both = one_after_the_other(VIEW, to)
    detector = Detector(**PANEL, readout=Readout(bits=None), binning=binning)
    assert detector.correction.flat_geometry == "commanded"
    with Imager(Source(), detector, skull_of_two(), commanded=both) as imager:
        reached = imager.render(to, Pose.identity(), 1)
        missed = imager.render(moved(to, 3), Pose.identity(), 1)
        beyond = imager.render(moved(to, 3), Pose.identity(), 2)
    assert reached[FREE] == pytest.approx(1, abs=1e-5)
    # 1 / r^2 and the cosine, at the corner of that part: half a per cent of 1 %.
    assert missed[60, 2:10].mean() == pytest.approx((560 / 557) ** 2, rel=1e-3)
    assert beyond[FREE] == pytest.approx(1, abs=1e-5)


def test_the_noise_of_the_one_flat_image_is_in_every_view():
    noise = {"noise": SnrNoise(kind="snr", snr=100), "correction": Correction(flat_frames=1)}
    both = one_after_the_other(VIEW, moved(VIEW, 40))
    with Imager(Source(), Detector(**PANEL, **noise), skull_of_two(), commanded=both) as imager:
        first, scaled = (imager.frame(HERE, view).flat for view in (0, 1))
    # Neighbours of the scaled image differ by 1 % of noise, of the scale by 1e-4.
    assert np.abs(np.diff(scaled / first)).max() < 3e-4


def test_what_the_first_flat_does_not_know_stays_in_the_image():
    fixed = {"correction": Correction(flat_geometry="first"), "readout": Readout(bits=None)}
    nearer = moved(VIEW, 10)
    with Imager(Source(), Detector(**PANEL, **fixed), skull_of_two(), commanded=VIEW) as imager:
        shifted = imager.render(nearer, Pose.identity())
    assert shifted[60, 2:10].mean() == pytest.approx((600 / 590) ** 2, rel=0.01)
    assert image(fixed)[FREE] == pytest.approx(1, abs=1e-5)


def test_a_partly_covered_pixel_has_the_covered_share():
    # An opaque plate whose edges pass inside pixels.
    plate = box((0, 3.31, -2.17), (1, 30.0, 21.0))
    specimen = BuiltSpecimen((BuiltPart("plate", material("Au"), plate),), Pose.identity())
    lead = {"energy_kev": 10.0}
    sampled = image({"pixel_samples": 8}, lead, specimen=specimen)
    # The near face of the plate at x = 0.5 casts the larger shadow, magnified 600 / 299.5.
    m = 600 / 299.5
    pixels = [(np.arange(n) - (n - 1) / 2) * 1.5 for n in (120, 160)]
    edges = [(-2.17 - 10.5, -2.17 + 10.5), (3.31 - 15, 3.31 + 15)]
    covered = [
        np.clip(np.minimum(x + 0.75, m * high) - np.maximum(x - 0.75, m * low), 0, 1.5) / 1.5
        for x, (low, high) in zip(pixels, edges, strict=True)
    ]
    expected = 1 - covered[0][:, None] * covered[1][None, :]
    assert np.abs(sampled - expected).max() < 1 / 8 + 0.03
    single = image({"readout": Readout(bits=None)}, lead, specimen=specimen)
    assert np.abs(sampled - expected).mean() < 0.25 * np.abs(single - expected).mean()


def test_bad_pixels_are_dark_in_the_raw_image_and_mended_in_the_corrected_one():
    bad = frame({"bad_pixels": RandomBadPixels(kind="random", share=0.02)}, seed=5)
    dead = bad.raw == 0
    assert dead.mean() == pytest.approx(0.02, rel=0.3)
    good = image({"readout": Readout(bits=None)})
    assert np.abs(bad.transmission - good)[dead].mean() < 0.01
    assert np.array_equal(
        bad.raw, frame({"bad_pixels": RandomBadPixels(kind="random", share=0.02)}, seed=5).raw
    )


def test_quantum_noise_without_a_photon_number_is_refused():
    data = {
        "trajectory": {"kind": "circle", "views": 3},
        "specimen": {"parts": [{"shape": {"kind": "sphere", "radius_mm": 3}}]},
        "detector": {"noise": {"kind": "quantum"}},
    }
    with pytest.raises(ScenarioError, match="photons_per_mm2_mas"):
        parse_scenario(data)
    parse_scenario(data | {"source": {"photons_per_mm2_mas": 1e6}})
    parse_scenario(data | {"source": {"spectrum": {"kind": "tube", "kvp": 80}}})


def test_a_map_of_another_panel_is_refused(tmp_path):
    np.save(tmp_path / "map.npy", np.zeros((3, 4)))
    section = {"bad_pixels": {"kind": "file", "path": tmp_path / "map.npy"}}
    with pytest.raises(InputError, match="the panel has"):
        image(section)


def test_scatter_lifts_what_lies_in_the_shadow():
    clean = image({"readout": Readout(bits=None)})
    lifted = image({"readout": Readout(bits=None), "scatter": SCATTER})
    dark = clean < 0.2
    added = lifted - clean
    assert added.min() > 0
    # A ball of bone of 50 mm: a few per cent of the free beam, smooth over the panel.
    assert 0.002 < added[dark].mean() < 0.05
    assert added[dark].std() < 0.2 * added[dark].mean()


def by_mas(detector, mas):
    """Frames of views at one place, of these mAs in units of the source's."""
    source = Source(photons_per_mm2_mas=PHOTONS, current_ma=2.0, exposure_ms=5.0)
    commanded = ScanGeometry.joined([VIEW] * len(mas))
    images = []
    loads = np.array(mas) * source.mas
    with Imager(
        source, Detector(**PANEL, **detector), skull_of_two(), commanded=commanded, mas=loads
    ) as imager:
        for view in range(len(mas)):
            images.append(imager.frame(HERE, view, HERE if view else None))
    return images


@pytest.mark.parametrize(
    "noise", [QuantumNoise(kind="quantum"), SnrNoise(kind="snr", snr=60)], ids=["quantum", "snr"]
)
def test_four_times_the_mas_have_a_quarter_of_the_noise_variance(noise):
    quiet = by_mas({"readout": Readout(bits=None)}, [1.0])[0].transmission
    response = {"response": {"kind": "counting"}, "noise": noise}
    one, four = (found.transmission - quiet for found in by_mas(response, [1.0, 4.0]))
    # Two variances of 3600 pixels each: 2.4 % each, one deviation.
    ratio = one[FREE].var() / four[FREE].var()
    sys.stdout.write(f"free beam: variance at one mAs by that at 4 times as many: {ratio:.3f}\n")
    assert ratio == pytest.approx(4, rel=0.12)
    behind = quiet < 0.3
    assert one[behind].var() / four[behind].var() == pytest.approx(4, rel=0.2)


@pytest.mark.parametrize("way", ["view", "first", "commanded"])
def test_without_noise_transmission_is_the_same_at_any_mas(way):
    correction = Correction(flat_geometry=way)
    detector = {"readout": Readout(bits=None), "correction": correction}
    same, *others = by_mas(detector, [3.0, 1.0, 0.25])
    for found in others:
        np.testing.assert_allclose(found.transmission, same.transmission, rtol=2e-5)
    ratio = (others[0].raw - 500) / (others[1].raw - 500)
    np.testing.assert_allclose(ratio, 4, rtol=1e-4)


def test_the_free_beam_of_the_largest_mas_sets_the_gain():
    found = by_mas({"readout": Readout(free_beam=60000)}, [1.0, 4.0])
    assert found[1].raw.max() == pytest.approx(60500, rel=1e-3)  # and not saturated
    assert found[0].raw.max() == pytest.approx(15500, rel=1e-3)


def test_lag_carries_on_what_the_mas_of_the_view_before_left():
    found = by_mas({"readout": Readout(bits=None), "lag": 0.2}, [3.0, 1.0])
    signal = found[1].raw[60, 10] - 500, found[0].raw[60, 10] - 500
    assert signal[0] / signal[1] == pytest.approx((0.8 * 1 + 0.2 * 3) / 3, rel=1e-4)


@pytest.mark.parametrize(
    "more",
    [
        {"noise": QuantumNoise(kind="quantum")},
        {"noise": QuantumNoise(kind="quantum"), "binning": 2},
        {"noise": SnrNoise(kind="snr", snr=40.0)},
        {
            "noise": QuantumNoise(kind="quantum"),
            "point_spread": GaussianSpread(kind="gaussian", sigma_mm=1.5),
        },
    ],
    ids=["quantum", "binned", "snr", "blurred"],
)
def test_photons_of_the_free_beam_have_the_noise_of_its_images(more):
    source = Source(photons_per_mm2_mas=PHOTONS / 10)
    photons = free_photons(source, Detector(**PANEL, **more), VIEW)
    assert photons is not None
    free = frame(more, {"photons_per_mm2_mas": PHOTONS / 10}).transmission[FREE]
    # Of 3600 pixels: one deviation of the variance is 2.4 %; the beam falls off to the corners.
    assert photons.single == pytest.approx(1 / free.var(), rel=0.15)
    blurred = "point_spread" in more
    assert (photons.single > 1.5 * photons.number) == blurred
    sums = free.reshape(20, 6, 5, 6).mean((1, 3))
    assert photons.number == pytest.approx(1 / (36 * sums.var()), rel=0.5)
    assert free_photons(source, Detector(**PANEL), VIEW) is None
