"""What is wrong with source and detector is found before any work, each with its key and file."""

import numpy as np
import pytest

from twinct.core.errors import InputError
from twinct.geometry import ScanGeometry
from twinct.scenario import Detector, Source
from twinct.xray.check import check_parts

TUBE = {"kind": "tube", "kvp": 90}
SPECTRUM = {"kind": "file", "path": "file"}
SPOT = {"kind": "image", "path": "file.npy", "size_mm": 1.0}
RESPONSE = {"kind": "file", "path": "file"}
MTF = {"kind": "mtf", "path": "file"}
BAD = {"kind": "file", "path": "file.npy"}
ONE_PIXEL = [[1, 0], [0, 0]]


def lead(thickness_mm):
    return TUBE | {"filters": [{"material": "Pb", "thickness_mm": thickness_mm}]}


def check(tmp_path, content=None, source=None, detector=None):
    """Check sections whose files have this content: text, or an array."""
    if isinstance(content, str):
        (tmp_path / "file").write_text(content)
    elif content is not None:
        np.save(tmp_path / "file.npy", np.array(content))

    def placed(sections):
        return {
            key: value | ({"path": tmp_path / value["path"]} if "path" in value else {})
            for key, value in (sections or {}).items()
        }

    made = Detector(columns=3, rows=2, pixel_pitch_mm=0.5, **placed(detector))
    views = ScanGeometry([[300, 0, 0]], [[-300, 0, 0]], [[0, 1, 0]], [[0, 0, 1]], made.panel)
    check_parts(Source(**placed(source)), made, views)


@pytest.mark.parametrize(
    ("content", "source", "detector"),
    [
        (None, {}, {}),
        (None, {"spectrum": lead(0.5)}, {}),
        ("20 1 # soft\n90, 2\n", {"spectrum": SPECTRUM}, {}),
        ("5 0\n100 1\n", {"spectrum": TUBE}, {"response": RESPONSE}),
        ("70 0.3\n85 0.2\n", {}, {"response": RESPONSE}),
        ("0 1\n0.1 1.03\n1 0.7\n", {}, {"point_spread": MTF}),  # up to the Nyquist frequency
        ("0 1\n0.2 0.09\n", {}, {"point_spread": MTF}),  # below it, and low
        (ONE_PIXEL, {"focal_spot": SPOT}, {}),
        ([[1, 0, 0], [0, 0, 0]], {}, {"bad_pixels": BAD}),
        (None, {"focal_spot": {"kind": "gaussian", "sigma_mm": (37.0, 1.0)}}, {}),
    ],
)
def test_what_can_be_used_passes(tmp_path, content, source, detector):
    check(tmp_path, content, source, detector)


FILTERS = "source.spectrum.filters"
UNKNOWN = {"material": "unobtainium", "thickness_mm": 1}
HALF = {"material": {"mass_fractions": {"Cu": 0.5}, "density_g_cm3": 9}, "thickness_mm": 1}
NO_FORMULA = {"material": {"formula": "Qq", "density_g_cm3": 9}, "thickness_mm": 1}


@pytest.mark.parametrize(
    ("content", "section", "reason"),
    [
        ("20 1 3\n", SPECTRUM, "source.spectrum.path: FILE:1: expected 2 columns, found 3"),
        ("20\n", SPECTRUM, "source.spectrum.path: FILE:1: expected 2 columns, found 1"),
        ("# nothing\n", SPECTRUM, "source.spectrum.path: FILE: the file holds no numbers"),
        ("20 1\nhello 2\n", SPECTRUM, "source.spectrum.path: FILE:2: expected 2 columns of num"),
        ("20 1\n30 nan\n", SPECTRUM, "source.spectrum.path: FILE:2: '30 nan': .* finite"),
        ("20 -7\n", SPECTRUM, "source.spectrum.path: FILE: a bin has -7 photons"),
        ("20 0\n", SPECTRUM, "source.spectrum.path: FILE: .* all bins are empty"),
        ("20 1\n20 2\n", SPECTRUM, "source.spectrum.path: FILE: the energies .* must rise"),
        ("20 1\n2000 2\n", SPECTRUM, "source.spectrum.path: FILE: photons of 20 to 2000 keV"),
        (None, SPECTRUM | {"path": "."}, "source.spectrum.path: .*, but the file is a folder"),
        (None, TUBE | {"filters": [UNKNOWN]}, f"{FILTERS}.0.material: unknown material 'unobt"),
        (None, TUBE | {"filters": [HALF]}, f"{FILTERS}.0.material: .* add up to 0.5"),
        (None, TUBE | {"filters": [NO_FORMULA]}, f"{FILTERS}.0.material: formula 'Qq'"),
        (None, lead(100), f"{FILTERS}: 100 mm Pb let .* of the photons through"),
    ],
)
def test_a_spectrum_that_cannot_be_used_is_named(tmp_path, content, section, reason):
    with pytest.raises(InputError, match="^" + reason.replace("FILE", str(tmp_path / "file"))):
        check(tmp_path, content, {"spectrum": section})


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (np.ones((2, 2, 2)), "not shape"),
        ([[1, np.nan]], "not NaN"),
        ([[1, -2.0]], "not have negative intensity, but has -2"),
        ([[0, 0]], "is 0 everywhere"),
        ([["a", "b"]], "it does not hold an array of numbers"),
        (np.array([[{}]]), "it holds Python objects"),
    ],
)
def test_a_spot_image_that_cannot_be_used_is_named(tmp_path, content, reason):
    file = tmp_path / "file.npy"
    with pytest.raises(InputError, match=f"^source.focal_spot.path: {file}: .*{reason}"):
        check(tmp_path, content, {"focal_spot": SPOT})


@pytest.mark.parametrize("name", ["file.npy", "file.png"])
def test_what_is_no_image_at_all_is_said_in_our_words(tmp_path, name):
    for content in (b"", b"neither of them"):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=f"{name}: cannot be read .* does not hold") as caught:
            check(tmp_path, None, {"focal_spot": SPOT | {"path": name}})
        assert "pickle" not in str(caught.value)


@pytest.mark.parametrize(
    ("spot", "reason"),
    [
        ({"kind": "gaussian", "sigma_mm": 38.0}, "sigma_mm: a spot 152 mm wide .* at most 150 mm"),
        ({"kind": "square", "size_mm": (1.0, 151.0)}, "size_mm: a spot 151 mm wide is too wide"),
    ],
)
def test_a_spot_as_large_as_the_setup_is_none(tmp_path, spot, reason):
    with pytest.raises(InputError, match=f"^source.focal_spot.{reason}"):
        check(tmp_path, None, {"focal_spot": spot})


@pytest.mark.parametrize(
    ("content", "source", "reason"),
    [
        ("5 0.9\n200 1.8\n", {}, "FILE: a share is 1.8"),
        ("5 -0.1\n200 0.8\n", {}, "FILE: a share is -0.1"),
        ("90 0.1\n20 0.8\n", {}, "FILE: the energies must rise"),
        ("5 0\n200 0\n", {}, "FILE: the detector absorbs nothing"),
        ("30 0.9\n50 0.8\n", {}, "FILE covers 30 to 50 keV, but 100 % .* have 80 to 80 keV"),
        ("30 0.9\n50 0.8\n", {"spectrum": TUBE}, "FILE covers 30 to 50 keV, but 5. %"),
    ],
)
def test_a_response_that_cannot_be_used_is_named(tmp_path, content, source, reason):
    """Also where the image would not depend on it, as with one energy."""
    match = "^detector.response.path: " + reason.replace("FILE", str(tmp_path / "file"))
    with pytest.raises(InputError, match=match):
        check(tmp_path, content, source, {"response": RESPONSE})


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ("0 1\n0.5 1.2\n1 0\n", "a modulation is 1.2"),
        ("0 1\n0.5 -0.2\n1 0\n", "a modulation is -0.2"),
        ("0 0.5\n1 0.3\n", "must start with .* not with 0 and 0.5"),
        ("0.05 1\n1 0.3\n", "must start with .* not with 0.05 and 1"),
        ("0 1\n0.5 0.2\n0.1 0.3\n", "the frequencies of an MTF must rise"),
        ("0 1\n0.5 0.2\n", "ends at 0.5/mm with a modulation of 0.2; .* frequency, 1/mm"),
    ],
)
def test_an_mtf_that_cannot_be_used_is_named(tmp_path, content, reason):
    match = f"^detector.point_spread.path: {tmp_path / 'file'}: .*{reason}"
    with pytest.raises(InputError, match=match):
        check(tmp_path, content, None, {"point_spread": MTF})


@pytest.mark.parametrize(
    ("content", "reason"), [(np.zeros((3, 2)), "the panel has"), (np.ones((2, 3)), "every pixel")]
)
def test_a_map_of_bad_pixels_that_cannot_be_used_is_named(tmp_path, content, reason):
    match = f"^detector.bad_pixels.path: {tmp_path / 'file.npy'}: .*{reason}"
    with pytest.raises(InputError, match=match):
        check(tmp_path, content, None, {"bad_pixels": BAD})


def test_every_problem_is_found_at_once(tmp_path):
    with pytest.raises(InputError) as caught:
        check(
            tmp_path,
            "1 2 3\n",
            {"spectrum": TUBE | {"filters": [UNKNOWN, HALF]}, "focal_spot": SPOT},
            {"response": RESPONSE, "point_spread": MTF, "bad_pixels": BAD},
        )
    keys = [problem.split(": ")[0] for problem in caught.value.problems]
    assert sorted(keys) == [
        "detector.bad_pixels.path",
        "detector.point_spread.path",
        "detector.response.path",
        "source.focal_spot.path",
        f"{FILTERS}.0.material",
        f"{FILTERS}.1.material",
    ]
