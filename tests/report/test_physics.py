"""Source and detector in words."""

from dataclasses import replace

import pytest

from twinct.geometry.wire import PosePairs
from twinct.report import figures, physics_in_words, render_report
from twinct.scenario import parse_scenario
from twinct.trajectory import commanded_views

BASE = {
    "detector": {"columns": 80, "rows": 60, "pixel_pitch_mm": 4.0},
    "trajectory": {"kind": "circle", "views": 3},
    "specimen": {"parts": [{"shape": {"kind": "sphere", "radius_mm": 3}}]},
}
TUBE = {"kind": "tube", "kvp": 90, "filters": [{"material": "Cu", "thickness_mm": 0.2}]}


def words(source=None, detector=None, tilt=0.0):
    scenario = parse_scenario(
        BASE
        | {"source": source or {}, "detector": BASE["detector"] | (detector or {})}
        | {"trajectory": BASE["trajectory"] | {"tilt_deg": tilt}}
    )
    views = commanded_views(scenario.trajectory, scenario.detector.panel)
    return physics_in_words(scenario, *PosePairs.from_geometry(views)[0])


def test_the_ideal_is_short():
    assert words() == {"Source": "80 keV", "Detector": "80 × 60 px of 4 × 4 mm"}


def test_photons_per_pixel_are_those_of_its_whole_area():
    source = {"photons_per_mm2_mas": 1e5, "current_ma": 2.0, "exposure_ms": 5.0}
    # 1e5 x 0.01 mAs x 16 mm2 x (1000 / 600)^2, of binned pixels and at any tilt alike.
    expected = "80 keV; 0.01 mAs; 4.44e+04 photons per pixel in the free beam"
    assert words(source)["Source"] == expected
    assert words(source, {"binning": 2}, tilt=30.0)["Source"] == expected


def test_a_tube_tells_the_energy_that_the_detector_sees():
    text = words({"spectrum": TUBE})["Source"]
    assert text.startswith("tube 90 kV, W at 12 deg; filtered by 0.2 mm Cu; 0.01 mAs; mean energy")
    seen = {
        kind: float(
            words({"spectrum": TUBE}, {"response": r})["Source"].split(" keV; ")[-2].split()[-1]
        )
        for kind, r in (
            ("integrating", {"kind": "integrating"}),
            ("counting", {"kind": "counting"}),
        )
    }
    assert 45 < seen["counting"] < seen["integrating"] < 65


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ({"focal_spot": {"kind": "gaussian", "sigma_mm": (0.5, 0.2)}}, "sigma 0.5 × 0.2 mm"),
        ({"focal_spot": {"kind": "square", "size_mm": 2.0}}, "square spot of 2 mm"),
        ({"focal_spot": {"kind": "image", "path": "a/b.npy", "size_mm": 2.0}}, "spot b.npy of 2"),
        ({"motion_samples": 8, "exposure_ms": 200.0}, "motion blur, 8 instants of 200 ms"),
    ],
)
def test_what_is_set_of_the_source_is_said(source, said):
    assert said in words(source)["Source"]


@pytest.mark.parametrize(
    ("detector", "said"),
    [
        ({"response": {"kind": "counting"}}, "photon counting"),
        ({"response": {"kind": "scintillator", "thickness_mm": 0.2}}, "0.2 mm CsI"),
        ({"response": {"kind": "file", "path": "a/r.txt"}}, "efficiency r.txt"),
        ({"pixel_samples": 4}, "4 × 4 samples a pixel"),
        ({"binning": 2}, "each binned from 2 × 2"),
        ({"point_spread": {"kind": "gaussian", "sigma_mm": 0.3}}, "spread, sigma 0.3 mm"),
        ({"point_spread": {"kind": "mtf", "path": "a/m.txt"}}, "MTF m.txt"),
        ({"noise": {"kind": "snr", "snr": 50.0}}, "SNR 50"),
        (
            {"readout": {"electronic_noise": 2.0}},
            "16 bit, free beam 50000 above an offset of 500; electronic",
        ),
        (
            {"readout": {"bits": None, "saturation": 6e4}},
            "fractions, free beam 50000 above an offset of 500; s",
        ),
        ({"bad_pixels": {"kind": "random", "share": 0.01}}, "1 % bad pixels"),
        ({"bad_pixels": {"kind": "file", "path": "a/b.npy"}}, "bad pixels b.npy"),
        ({"lag": 0.05}, "lag 5 %"),
        (
            {
                "grid": {
                    **{"along": "u", "ratio": 8, "lines_per_cm": 40, "strip_mm": 0.04},
                    **{"focus_mm": 900},
                }
            },
            "grid 8:1, 40 lines/cm along u, focus 900 mm",
        ),
        (
            {"response": {"kind": "scintillator", "thickness_mm": 0.6, "swank": 0.9}},
            "0.6 mm CsI, Swank factor 0.9",
        ),
        ({"scatter": {"kind": "monte_carlo"}}, "scatter by Monte Carlo"),
        ({"correction": {"flat_frames": 4}}, "4 flat, 0 dark frames"),
        ({"correction": {"flat_geometry": "first"}}, "flat image of the first view"),
    ],
)
def test_what_is_set_of_the_detector_is_said(detector, said):
    assert said in words(None, detector)["Detector"]


def test_the_report_says_it(report):
    data = report.scenario.model_dump(mode="json") | {"source": {"photons_per_mm2_mas": 1e5}}
    data["detector"]["noise"] = {"kind": "quantum"}
    names = ("room", "path", "errors", "convergence", "slices", "projections")
    pictures = dict.fromkeys(names, figures.Picture(b"a dot", "image/png"))
    html = render_report(replace(report, scenario=parse_scenario(data)), pictures)
    assert "photons per pixel in the free beam" in html
    assert "quantum noise" in html
