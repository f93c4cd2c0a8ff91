"""Grid, heel effect, bowtie and Swank noise in the images of a scan, and in the transport."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import spekpy

from twinct.core.errors import InputError, ScenarioError
from twinct.geometry import Panel, Pose, ScanGeometry, VolumeGrid
from twinct.scenario import Detector, Source, Specimen, load_scenario
from twinct.specimen import build_specimen
from twinct.specimen.materials import material
from twinct.transport import Beam, Simulation, VoxelBody
from twinct.transport import Detector as Scored
from twinct.xray import Imager
from twinct.xray.build import build_beam, build_grid, build_panel_response, build_response
from twinct.xray.check import check_parts
from twinct.xray.response import PhotonResponse, swank_factor
from twinct.xray.signal import Signal

PIXELS = {"rows": 12, "columns": 40, "pixel_pitch_mm": 9.0, "pixel_samples": 2}
PANEL = Panel(12, 40, 9.0, 9.0)
GRID = {"along": "v", "ratio": 10.0, "lines_per_cm": 40.0, "strip_mm": 0.043, "focus_mm": 1000.0}
BOWTIE = {
    "along": "u",
    "material": "aluminium",
    "angles_deg": [0, 4, 10],
    "thickness_mm": [1, 4, 9],
}
TUBE = {"kind": "tube", "kvp": 100, "anode_angle_deg": 14, "anode_side": "+u"}


def view(shift_mm: float = 0.0, sdd_mm: float = 1000.0) -> ScanGeometry:
    """Return a view along -z whose source is off the panel's middle along u."""
    source, panel = np.array([[shift_mm, 0.0, 600.0]]), np.array([[0.0, 0.0, 600.0 - sdd_mm]])
    return ScanGeometry(source, panel, np.array([[1.0, 0, 0]]), np.array([[0, 1.0, 0]]), PANEL)


def images(source: dict[str, Any], detector: dict[str, Any], seen: ScanGeometry) -> Any:
    """Return the transmission of a small ball far from the middle of the panel."""
    ball = {"shape": {"kind": "sphere", "radius_mm": 10}, "material": "water"}
    built = build_specimen(Specimen.model_validate({"parts": [ball]}))
    sections = Source.model_validate(source), Detector.model_validate(PIXELS | detector)
    with Imager(*sections, built, commanded=view(), engine="mesh") as imager:
        return imager.render(seen, Pose.identity())


def lit(source: Source, detector: Detector, seen: ScanGeometry) -> np.ndarray:
    """Return the free beam's signal, relative to that of a uniform one without a grid."""
    beam, response = build_beam(source), build_response(detector)
    of = Signal.lit(beam, build_grid(detector), response, seen)[0]
    plain = Signal.lit(build_beam(Source(energy_kev=60.0)), None, PhotonResponse.counting(), seen)[
        0
    ]
    return of / plain


def test_a_view_off_the_grids_focus_loses_light_at_the_edges() -> None:
    """Against the flat image at the focus, by the shadow of black strips (Day and Dance)."""
    air = {"energy_kev": 30.0}
    grid = {"grid": GRID | {"space": "air"}}
    near = images(air, grid, view(sdd_mm=800.0))
    plain = images(air, {}, view(sdd_mm=800.0))
    x = (np.arange(40) - 19.5) * 9.0
    # Lead of 2 mm lets nothing pass; the ray leans by x (1 / 800 - 1 / 1000) against the strips.
    expected = 1 - 10 * np.abs(x) * (1 / 800 - 1 / 1000)
    edge = np.s_[3, [0, 1, 2, 37, 38, 39]]
    # Photons pass the strips' edges, at 30 keV 0.03 mm of lead.
    np.testing.assert_allclose((near / plain)[edge], expected[edge[1]], atol=0.015)
    on = images(air, grid, view())
    np.testing.assert_allclose(on[edge], 1.0, atol=1e-5)
    # Strips along u do not mind: the panel is low.
    turned = images(air, {"grid": GRID | {"along": "u"}}, view(sdd_mm=800.0))
    assert (turned / plain)[6, 0] > 0.97


def test_source_off_the_middle_is_cut_off_everywhere_alike() -> None:
    grid = {"grid": GRID | {"space": "air"}}
    off = images({"energy_kev": 30.0}, grid, view(shift_mm=20.0))
    plain = images({"energy_kev": 30.0}, {}, view(shift_mm=20.0))
    np.testing.assert_allclose((off / plain)[3, ::6], 1 - 10 * 20 / 1000, atol=0.01)


def test_the_heel_effect_is_spekpys() -> None:
    """Signal of the free beam along u, against spectra of SpekPy at these places."""
    source = Source.model_validate({"spectrum": TUBE | {"filters": [], "bins": 1000}})
    found = lit(source, Detector.model_validate(PIXELS), view())[6]
    x = (np.arange(40) - 19.5) * 0.9
    energy = []
    for place in (x[1], x[12], x[38]):
        tube = spekpy.Spek(kvp=100, th=14, dk=1, mas=1, z=100, x=-place)
        kev, photons = (np.asarray(one) for one in tube.get_spectrum(diff=False))
        energy.append((kev * photons).sum() * (1 + (place / 100) ** 2))
    # A lattice of 65 nodes on 360 mm.
    np.testing.assert_allclose(found[12] / found[1], energy[1] / energy[0], rtol=2e-3)
    np.testing.assert_allclose(found[38] / found[1], energy[2] / energy[0], rtol=1e-2)
    assert found[38] < 0.75 * found[1]


def test_a_panel_beyond_the_anodes_face_is_refused() -> None:
    source = Source.model_validate({"spectrum": TUBE | {"anode_angle_deg": 9}})
    with pytest.raises(InputError, match=r"anode_side: the panel reaches 10\.\d deg .* at 9 deg"):
        check_parts(source, Detector.model_validate(PIXELS), view())


def test_a_bowtie_attenuates_by_its_thickness() -> None:
    source = Source.model_validate({"energy_kev": 60.0, "bowtie": BOWTIE})
    found = lit(
        source, Detector.model_validate(PIXELS | {"response": {"kind": "counting"}}), view()
    )
    u, v = (np.arange(40) - 19.5) * 9.0, (np.arange(12) - 5.5) * 9.0
    angle = np.degrees(np.arctan(np.abs(u) / 1000))
    thick = np.interp(angle, [0, 4, 10], [1, 4, 9]) - 1
    longer = np.sqrt(1 + (v[:, None] / 1000) ** 2 / (1 + (u / 1000) ** 2))
    mu = material("aluminium").mu_per_mm(60.0)
    # At the kink of 10 deg, a quarter of its change over a cell of 5.6 mm.
    np.testing.assert_allclose(found, np.exp(-mu * ((thick + 1) * longer - 1)), rtol=4e-3)


def test_images_are_divided_by_the_shaped_beam() -> None:
    """Far from the body the transmission is 1, with a harder beam behind the bowtie."""
    source = {"spectrum": TUBE, "bowtie": BOWTIE}
    found = images(source, {"grid": GRID}, view())
    np.testing.assert_allclose(found[[0, -1]], 1.0, atol=1e-4)
    assert 0.5 < found[6, 20] < 0.9


def test_photons_of_the_transport_follow_the_profile() -> None:
    """Primary image by the transport against the sum over the spectrum; emitted mean energy."""
    source = Source.model_validate(
        {"spectrum": TUBE | {"bins": 12}, "bowtie": BOWTIE, "photons_per_mm2_mas": 1e5}
    )
    detector = Detector.model_validate(PIXELS | {"grid": GRID})
    beam, grid, seen = build_beam(source), build_grid(detector), view()
    of_view = beam.beam(seen, 0)
    body = VoxelBody.of_labels(VolumeGrid((2, 2, 2), 1.0), np.zeros((2, 2, 2), int), {0: AIR}, None)
    panel = Scored(seen, 0, build_panel_response(detector).mean, grid)
    simulation = Simulation(body, of_view, dose=False, detector=panel)
    image = simulation.primary(4)
    expected = Signal.lit(beam, grid, build_response(detector), seen, samples=4)[0]
    number = beam.spectrum.total * 1e6 * of_view.solid_angle * of_view.share
    np.testing.assert_allclose(image * number / 81.0, expected, rtol=5e-3)
    # The mean energy of the photons that are emitted, by a sum over the panel.
    totals = simulation.run(20_000, 4, seed=2).totals[:, 0].mean() / 20_000
    weights = Signal.lit(beam, None, PhotonResponse.counting(), seen)[0].sum()
    energy = Signal.lit(beam, None, PhotonResponse.integrating(), seen)[0].sum() / weights
    assert totals == pytest.approx(float(energy), rel=0.005)


AIR = material("air")


def test_a_profile_that_does_not_fit_is_refused() -> None:
    with pytest.raises(InputError, match="needs factors for each line"):
        Beam.of_view(view(), 0, [60.0, 70.0], 1.0, np.ones((1, 2, 2)))
    with pytest.raises(InputError, match="at least 0"):
        Beam.of_view(view(), 0, [60.0], 1.0, -np.ones((1, 2, 2)))


def test_swank_noise_is_that_of_a_pulse_height_spectrum(figure: Any) -> None:
    """Light of single photons, drawn one by one from exponential heights: a factor of 1/2."""
    heights = (np.arange(4000) + 0.5) / 200
    factor = swank_factor(heights, np.exp(-heights))
    assert factor == pytest.approx(0.5, rel=1e-3)
    rng = np.random.default_rng(3)
    signals = [rng.exponential(50.0, n).sum() for n in rng.poisson(400.0, 20_000)]
    response = PhotonResponse.scintillator(material("tungsten"), 50.0, factor)
    mean, square = (float(f(np.array([50.0]))[0]) for f in (response.mean, response.square))
    assert np.mean(signals) == pytest.approx(400 * mean, rel=3e-3)
    # Variance of 20,000 draws: 1 %.
    assert np.var(signals) == pytest.approx(400 * square, rel=0.04)
    with pytest.raises(InputError, match="pulse heights"):
        swank_factor([1.0], [-1.0])


@pytest.mark.parametrize(
    "keys, said",
    [
        (
            {"detector.grid": {k: v for k, v in GRID.items() if k != "along"}},
            "grid.along: this req",
        ),
        (
            {"detector.grid": GRID | {"strip_mm": 0.3}},
            "leave no space: 40 lines per cm are 0.25 mm",
        ),
        ({"source.bowtie": BOWTIE | {"angles_deg": [1, 2, 3]}}, "must rise from 0"),
        ({"source.bowtie": BOWTIE | {"angles_deg": [0, 2]}}, "2 angles for 3 thicknesses"),
    ],
)
def test_impossible_sections_are_refused(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(ScenarioError, match=said):
        load_scenario("demo", keys)
