"""Reading: geometry against BAM's own toolbox, units and drifts by hand, refusals by name."""

from __future__ import annotations

import contextlib
import difflib

import numpy as np
import pytest
from small_ctsimu import small_scenario

from twinct.core.errors import ScenarioError
from twinct.ctsimu import load_ctsimu
from twinct.ctsimu.reader import JsonSection, Moment
from twinct.ctsimu.writing import material_entry, quantity, vector

ROUNDING_MM = 1e-9
"""Coordinates of 1e3 mm through a dozen rotations in double precision."""


def deviation(rng, kind, axis, known, **more):
    unit = "mm" if kind == "translation" else "deg"
    amount = quantity(float(rng.uniform(-5, 5)), unit)
    amount["drifts"] = [
        {"value": rng.uniform(-1, 1, 4).tolist(), "unit": unit, "known_to_reconstruction": k}
        for k in (True, False)
    ]
    return {
        "type": kind, "axis": axis, "amount": amount, "known_to_reconstruction": known, **more,
    }  # fmt: skip


def moved(data, seed):
    """Everything moves: deviations of all kinds, drifts known and unknown, a turning stage."""
    rng = np.random.default_rng(seed)

    def vec(names="xyz", unit=None):
        return vector(rng.normal(size=3), names, unit)

    for part in ("detector", "source", "stage"):
        place = data["geometry"][part]
        place["deviations"] = [
            deviation(rng, "translation", "x", False),
            deviation(rng, "rotation", "v", True),
            deviation(rng, "rotation", vec("uvw"), False, pivot=vec("xyz", "mm")),
            deviation(rng, "rotation", vec("xyz"), True, pivot=vec("uvw", "mm")),
        ]
        place["center"]["z"]["drifts"] = [
            {"value": rng.uniform(-9, 9, 3).tolist(), "unit": "mm", "known_to_reconstruction": k}
            for k in (True, False)
        ]
    position = data["samples"][0]["position"]
    position["center"]["v"] = quantity(2.0, "cm")
    position["deviations"] = [
        deviation(rng, "rotation", "s", True, pivot=vec("rst", "mm")),
        deviation(rng, "rotation", "y", False, pivot=vec("uvw", "mm")),
        deviation(rng, "translation", vec("rst"), True),
    ]
    data["acquisition"] |= {
        "number_of_projections": 6, "direction": "CW", "include_final_angle": bool(seed % 2),
    }  # fmt: skip
    return data


@pytest.mark.parametrize("believed", [False, True])
@pytest.mark.parametrize("seed", [1, 2])
def test_geometry_is_that_of_the_toolbox(data, write, seed, believed):
    toolbox = pytest.importorskip("ctsimu.scenario", reason="needs the extra ctsimu")
    path = write(moved(data, seed))
    ours = load_ctsimu(path)
    theirs = toolbox.Scenario(str(path))

    def array(v):
        return np.array([v.x(), v.y(), v.z()])

    for index in range(6):
        theirs.set_frame(index, reconstruction=believed)
        frame = ours.frame(index, believed)
        geometry = theirs.current_geometry()
        stage = frame.world_from_stage
        pairs = {
            "source": (frame.view.source[0], array(geometry.source.center)),
            "panel": (frame.view.detector[0], array(geometry.detector.center)),
            "u": (frame.view.u[0], array(geometry.detector.u)),
            "v": (frame.view.v[0], -array(geometry.detector.v)),
            "stage": (stage.position, array(geometry.stage.center)),
            "stage w": (stage.rotation[:, 2], array(geometry.stage.w)),
            "source u": (frame.source_axes[0], array(geometry.source.u)),
        }
        sample = theirs.samples[0].coordinate_system
        body = frame.samples[0].world_from_sample
        pairs["sample"] = body.position, stage.apply(array(sample.center))
        pairs["sample r"] = body.rotation[:, 0], stage.rotate(array(sample.u))
        for name, (own, other) in pairs.items():
            np.testing.assert_allclose(own, other, atol=ROUNDING_MM, err_msg=name)


def test_deviations_unknown_to_reconstruction_are_not_believed(data, write):
    amount = quantity(1.0, "mm")
    data["geometry"]["detector"]["deviations"] = [
        {"type": "translation", "axis": "z", "amount": amount, "known_to_reconstruction": False},
        {"type": "translation", "axis": "y", "amount": amount},
    ]
    scenario = load_ctsimu(write(data))
    np.testing.assert_allclose(scenario.frame(0).view.detector[0], [400, 1, 1])
    np.testing.assert_allclose(scenario.frame(0, believed=True).view.detector[0], [400, 1, 0])


def test_row_0_is_on_top_whichever_way_w_points(data, write):
    away = load_ctsimu(write(data)).frame(0)
    data["geometry"]["detector"]["vector_w"]["x"] = quantity(-1)
    towards = load_ctsimu(write(data)).frame(0)
    for frame, row_0 in ((away, 1.0), (towards, -1.0)):
        v_down = frame.view.v[0] * (-1 if frame.upside_down else 1)
        np.testing.assert_allclose(v_down, [0, 0, -row_0])
        assert frame.view.normal[0] @ frame.view.source[0] > 0 or frame.view.normal[0][0] < 0


@pytest.mark.parametrize(
    ("parameter", "unit", "frame", "expected"),
    [
        ({"value": 2, "unit": "um"}, "mm", 0, 0.002),
        ({"value": 1, "unit": "kg/m^3"}, "g/cm^3", 0, 0.001),
        ({"value": 180, "unit": "deg"}, "rad", 0, np.pi),
        ({"value": 1, "unit": "mm", "drifts": [{"value": [0, 3], "unit": "cm"}]}, "mm", 1, 11.0),
        ({"value": 1, "unit": "cm", "drifts": [{"value": [0, 3]}]}, "mm", 3, 40.0),
        ({"value": 1, "unit": "mm", "drifts": [{"value": 5}]}, "mm", 2, 6.0),
        ({"value": 1, "drifts": [{"value": [0, 1, 4, 9]}, {"value": [1, 1]}]}, "", 2, 6.0),
    ],
)
def test_numbers_by_hand(tmp_path, parameter, unit, frame, expected):
    section = JsonSection({"x": parameter}, "", Moment(frame, 4), tmp_path, {})
    assert section.number("x", unit) == pytest.approx(expected)
    assert not section.problems


def test_text_drifts_hold_until_the_next(tmp_path):
    data = {"file": {"value": "a", "drifts": [{"value": ["b", "c"]}]}}
    found = [JsonSection(data, "", Moment(i, 4), tmp_path, {}).text("file") for i in range(4)]
    assert found == ["b", "b", "b", "c"]


def change(data, key, value):
    *path, last = key
    for step in path:
        data = data.setdefault(step, {}) if isinstance(data, dict) else data[step]
    data[last] = value


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        (("geometry", "source", "type"), "parallel", ["geometry.source.type", "parallel", "cone"]),
        (("acquisition", "scattering"), True, ["acquisition.scattering"]),
        (("acquisition", "scan_mode"), "continuous", ["scan_mode", "stop+go"]),
        (
            ("detector", "sharpness"),
            {"value": 1},
            ["detector.sharpness: unknown key", "'unsharpness'"],
        ),
        (("detector", "columns"), {"value": 2, "units": "px"}, ["columns.units"]),
        (("samples", 0, "material_id"), "Unobtainium", ["samples[0]", "Unobtainium", "Fe"]),
        (("samples", 0, "file"), {"value": "none.stl"}, ["samples[0].file", "no file at"]),
        (("source", "voltage"), {"value": 1, "unit": "mm"}, ["source.voltage", "kV"]),
        (("source", "spot"), {"size": {"w": quantity(1.0, "mm")}}, ["source.spot", "depth"]),
        (("file", "file_format_version"), {"major": 0, "minor": 9}, ["0.9", "1.2"]),
        (("geometry", "stage", "vector_u"), vector([1, 0, 1]), ["orthogonal", "45.0"]),
    ],
)
def test_what_is_not_supported_is_refused_by_name(data, write, key, value, words):
    change(data, key, value)
    with pytest.raises(ScenarioError) as refused:
        load_ctsimu(write(data))
    assert len(refused.value.problems) == 1
    for word in words:
        assert word in str(refused.value)


def test_all_problems_are_told_at_once(data, write):
    data["acquisition"]["scattering"] = True
    data["detector"]["colour"] = "blue"
    with pytest.raises(ScenarioError) as refused:
        load_ctsimu(write(data))
    assert len(refused.value.problems) == 2


def mm(value, *drifts):
    return quantity(value, "mm") | {"drifts": list(drifts)}


def problems_of(path):
    with pytest.raises(ScenarioError) as refused:
        load_ctsimu(path)
    return [problem.removeprefix(f"{path}: ") for problem in refused.value.problems]


WRONG = [
    ("materials.0.density.value", -1, "materials[0].density: -1 g/cm^3 must be from 0 to 1e+09"),
    ("materials.0.density.value", float("inf"), "materials[0].density: holds a value that is not"),
    ("materials.0.density.value", 10**400, "materials[0].density: holds a value that"),
    ("materials.0.composition.0.mass_fraction.value", 1.2, "mass_fraction: 1.2 must be from 0"),
    ("materials.0.composition.0.mass_fraction.value", 0.3, "the mass fractions add up to 0.3"),
    ("materials.0.composition.0.formula.value", "Xx2", "composition[0].formula: 'Xx2' cannot be"),
    ("materials.1.id", "Al", "materials[1].id: 'Al' is already the id of an earlier material"),
    ("acquisition.number_of_projections", 0, "number_of_projections: 0 must be from 1 to 100000"),
    ("acquisition.number_of_projections", -3, "number_of_projections: -3 must be from 1"),
    ("acquisition.number_of_projections", "ten", "number_of_projections: 'ten' is not a number"),
    ("acquisition.number_of_projections", 2.5, "number_of_projections: 2.5 is not a whole number"),
    ("acquisition.number_of_projections", None, "acquisition.number_of_projections: is missing"),
    ("acquisition.frame_average", 0, "acquisition.frame_average: 0 must be from 1 to 100000"),
    ("acquisition.dark_field.number", -1, "acquisition.dark_field.number: -1 must be from 0"),
    ("acquisition.flat_field.frame_average", 0, "flat_field.frame_average: 0 must be from 1"),
    ("acquisition.pixel_binning", {"u": 0}, "acquisition.pixel_binning.u: 0 must be from 1"),
    ("acquisition.pixel_binning", {"u": 5}, "columns, rows: 24 x 16 cannot be binned 5 x 1"),
    ("acquisition.scan_speed", {"value": 3, "unit": "deg/s"}, "acquisition.scan_speed: is not"),
    ("detector.gray_value.imax.value", 0, "detector.gray_value.imax: 0 must be above imin, 0"),
    ("detector.gray_value.factor", {"value": 1e13}, "gray_value.factor, offset: one of them is"),
    ("detector.columns.value", 1e9, "detector.columns: 1e+09 px must be from 1 to 65536"),
    ("detector.columns.value", 65536, None),
    ("detector.columns", None, "detector.columns: is missing"),
    ("detector.bad_pixel_map", {"file": {"value": "cube.stl"}, "type": "x"}, "map.type: 'x'"),
    ("detector.integration_time.value", 1e308, "integration_time: 1e+308 s must be"),
    ("detector.gray_value.imax.value", 1e308, "gray_value.imax: 1e+308 must be from -1e+12"),
    ("detector.gray_value", {"offset": {"value": 0}, "factor": {"value": 1e99}}, "factor: 1e+99"),
    ("source.target", {"material_id": "x"}, "target.material_id: 'x' is not among the materials"),
    ("source.target", {"type": "x"}, "source.target.type: 'x' is not supported; allowed: refl"),
    ("samples.0.file.drifts", [{"value": ["", "cube.stl"]}], "file.drifts: holds an empty text"),
    ("samples.0.file.drifts", 0, "samples[0].file.drifts: is not an array of objects"),
    ("samples.0.file", {"value": 3, "drifts": [{"value": ["cube.stl"]}]}, "3 is not a text"),
    ("geometry.stage.deviations", [{"axis": "x", "amount": quantity(0, "deg")}], "type: is miss"),
    ("detector.pixel_pitch.u.value", 0, "detector.pixel_pitch.u: 0 mm must be above 0"),
    ("detector.pixel_pitch", None, "detector.pixel_pitch: is missing"),
    ("detector.bit_depth.value", 32, "detector.bit_depth: 32 must be from 1 to 16"),
    ("detector.integration_time.value", 0, "detector.integration_time: 0 s must be above 0"),
    ("detector.image_lag", {"value": 1}, "detector.image_lag: 1 must be at least 0 and below 1"),
    ("detector.noise", {"snr_at_imax": {"value": 0}}, "noise.snr_at_imax: 0 must be above 0"),
    ("detector.unsharpness", {"basic_spatial_resolution": mm(-1)}, "-1 mm must be from 0"),
    ("detector.scintillator", {"thickness": {"value": 1, "unit": "mm"}}, "material_id: is missing"),
    ("detector.window", {"front": [{"material_id": "Al"}]}, "front[0].thickness: is missing"),
    ("source.voltage.value", 0, "source.voltage: 0 kV must be above 0 and at most 800"),
    ("source.voltage.value", 1000, "source.voltage: 1000 kV must be above 0 and at most 800"),
    ("source.voltage", None, "source.voltage: is missing"),
    ("source.current.value", -1, "source.current: -1 mA must be from 0"),
    ("source.filters", [{"material_id": "Al", "thickness": mm(-1)}], "filters[0].thickness: -1"),
    ("source.spot", {"sigma": {"u": {"value": -1, "unit": "mm"}}}, "source.spot.sigma.u: -1 mm"),
    ("source.spot", {"size": {"v": {"value": -1, "unit": "mm"}}}, "source.spot.size.v: -1 mm"),
    ("samples.0.scaling_factor.s.value", 0, "samples[0].scaling_factor.s: 0 must be above 0"),
    ("samples.0.file", None, "samples[0].file: is missing"),
    ("samples.0.file", {"value": "."}, "is a folder, not a file"),
    ("samples.0.material_id", None, "samples[0].material_id: is missing"),
    ("geometry.detector.center.x.value", float("nan"), "center.x: holds a value that is not"),
    ("geometry.detector.center.x.value", 1e300, "center.x: 1e+300 mm must be from -1e+09"),
    ("geometry.detector.center.x.value", 0, "geometry.detector: the source lies in the plane"),
    ("geometry.detector.vector_u.y.value", 1e300, "detector.vector_u.y: 1e+300 must be from"),
    ("geometry.detector.vector_u", vector([1, 0, 0]), "orthogonal, but their angle is 0.0000 deg"),
    ("geometry.detector.vector_u", None, "geometry.detector.vector_u: is missing"),
    ("geometry.stage.center.z", mm(1, {"value": [0, float("nan")]}), "z.drifts: holds a value"),
    ("geometry.stage.center.z", mm(1, *2 * [{"value": 1e308}]), "center.z: inf mm must be from"),
    ("samples.0.position.center.u", mm(1, *2 * [{"value": 1e308}]), "center.u: inf mm must be"),
    ("samples.0.material_id", "x" * 999, "xxx... is not among the materials: Al, Fe"),
    ("geometry.stage.center.z", mm(1, {"file": "d"}), "does not exist"),
    ("geometry.stage.center.z", mm(1, {"file": "."}), "is a folder"),
    ("geometry.stage.center.z", mm(None, {"value": 1}), "has drifts, but no value"),
    ("detector", None, "detector: is missing"),
    ("geometry", None, "geometry: is missing"),
    ("source", None, "source: is missing"),
    ("acquisition", None, "acquisition: is missing"),
    ("file", None, "file: is missing"),
    ("file.file_type", None, "file.file_type: is missing"),
    ("sampels", [], "sampels: unknown key; did you mean 'samples'?"),
    ("file.descripton", "", "file.descripton: unknown key; did you mean 'description'?"),
    ("geometry.turntable", {}, "geometry.turntable: unknown key"),
    ("geometry.stage.center.q", None, "geometry.stage.center.q: unknown key"),
    ("geometry.stage.center.u", {"value": 1}, "geometry.stage.center.u: is not supported here"),
    ("geometry.stage.center.x.drift", None, "center.x.drift: unknown key; did you mean 'drifts'?"),
    ("acquisition.dark_field.idea", None, "dark_field.idea: unknown key; did you mean 'ideal'?"),
]  # fmt: skip


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("key", "value", "words"), WRONG, ids=lambda v: str(v)[:40])
def test_what_cannot_be_is_one_problem_with_its_key(data, write, key, value, words):
    change(data, [int(step) if step.isdigit() else step for step in key.split(".")], value)
    path = write(data)
    if words is None:
        assert load_ctsimu(path).frame(0).panel.columns == value
        return
    found = problems_of(path)
    assert len(found) == 1 and words in found[0], found
    assert "Errno" not in found[0]


@pytest.mark.filterwarnings("ignore")
def test_the_toolbox_reads_without_an_error_what_is_refused_here(write):
    """Why there is a reader of our own (docs/ctsimu.md); a toolbox that refuses more is news."""
    toolbox = pytest.importorskip("ctsimu.scenario", reason="needs the extra ctsimu")
    wrong = [(key, value) for key, value, words in WRONG if words is not None]
    read = 0
    for key, value in wrong:
        data = small_scenario()
        change(data, [int(step) if step.isdigit() else step for step in key.split(".")], value)
        with contextlib.suppress(Exception):  # it raises bare exceptions
            scenario = toolbox.Scenario(str(write(data)))
            scenario.set_frame(0)
            scenario.current_geometry()
            read += 1
    assert (read, len(wrong)) == (65, 78)


def test_panel_of_too_many_pixels_is_refused(data, write):
    data["detector"] |= {"columns": {"value": 65536}, "rows": {"value": 65536}}
    assert problems_of(write(data)) == [
        "detector.columns, rows: 65536 x 65536 pixels are more than the 268435456 allowed"
    ]


def test_needed_key_that_is_misspelt_is_one_problem(data, write):
    data["detector"]["pixel_pich"] = data["detector"].pop("pixel_pitch")
    data["detektor"] = data.pop("detector")
    assert problems_of(write(data)) == ["detektor: unknown key; did you mean 'detector'?"]
    data["detector"] = data.pop("detektor")
    assert problems_of(write(data)) == [
        "detector.pixel_pich: unknown key; did you mean 'pixel_pitch'?"
    ]


def test_known_keys_may_be_empty(data, write):
    data["geometry"]["stage"]["center"] |= {"u": None, "v": {"value": None, "unit": "mm"}}
    data["detector"] |= {
        "scintillator": {"material_id": None, "thickness": {"value": None, "unit": "mm"}},
        "bad_pixel_map": {"file": None, "type": "int16", "endian": "little", "headersize": 0},
        "noise": {"snr_at_imax": {"value": None}},
        "gray_value": {"factor": {"value": None, "unit": "1/J"}, "offset": {"value": None}},
    }
    data["source"] |= {"target": None, "spot": {"size": None}, "filters": [], "window": None}
    data["acquisition"] |= {"scan_speed": {"value": None, "unit": "deg/s"}, "comment": "x"}
    data["simulation"] = {"anything": {"at": "all"}}
    assert load_ctsimu(write(data)).frames == 3


def test_no_samples_are_a_free_beam_and_no_density_is_vacuum(data, write):
    data["samples"] = []
    data["materials"][0]["density"] = quantity(0.0, "g/cm^3")
    data["environment"]["material_id"] = "Al"
    frame = load_ctsimu(write(data)).frame(0)
    assert frame.samples == () and frame.environment is None


def test_mass_fractions_add_up_within_rounding(data, write):
    shares = {"N2": 0.7552, "O2": 0.2314, "Ar": 0.0128}  # of BAM's example, without its CO2
    data["materials"][1] = material_entry("Fe", 0.0013, shares)
    data["environment"]["material_id"] = "Fe"
    found = load_ctsimu(write(data)).frame(0).environment
    assert found.mass_fractions["Ar"] == pytest.approx(0.0128 / 0.9994)
    data["materials"][1] = material_entry("Fe", 0.0013, {**shares, "CO2": 0.02})
    assert "add up to 1.019" in problems_of(write(data))[0]


def test_problem_of_a_later_frame_says_which(data, write):
    data["source"]["voltage"]["drifts"] = [{"value": [0, -60, -120], "unit": "kV"}]
    assert problems_of(write(data)) == [
        "source.voltage: -40 kV must be above 0 and at most 800 (frame 2)"
    ]


def test_spectrum_needs_a_current(data, write, tmp_path):
    (tmp_path / "spectrum.tsv").write_text("50 1\n60 2\n")
    data["source"]["spectrum"] = {"monochromatic": False, "file": {"value": "spectrum.tsv"}}
    data["source"]["current"] = quantity(0.0, "mA")
    assert problems_of(write(data)) == ["source.current: 0 mA gives no radiation"]
    del data["source"]["current"]
    assert problems_of(write(data)) == ["source.current: is missing"]


CURVES = {
    "source.spectrum": "file",
    "detector.gray_value": "intensity_characteristics_file",
    "detector.noise": "noise_characteristics_file",
    "detector.unsharpness": "mtf",
}


@pytest.mark.parametrize("place", CURVES)
@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1 2\n0 3\n", "the first column must rise"),
        ("1 2\n2 nan\n", "the numbers must be finite"),
        ("1 2\ntwo 3\n", "expected 2 columns of numbers"),
        ("", "holds no numbers"),
    ],
)
def test_broken_curve_is_named_with_its_key(data, write, tmp_path, place, text, words):
    data["source"]["spectrum"] = {"monochromatic": False, "file": {"value": "good.tsv"}}
    (tmp_path / "good.tsv").write_text("50 1\n60 2\n")
    (tmp_path / "bad.tsv").write_text(text)
    change(data, [*place.split("."), CURVES[place]], {"value": "bad.tsv"})
    found = problems_of(write(data))
    assert len(found) == 1 and words in found[0], found
    assert found[0].startswith(f"{place}.{CURVES[place]}: {tmp_path / 'bad.tsv'}:")


def test_broken_picture_is_named_with_its_key(data, write, tmp_path):
    np.zeros(7, "<i2").tofile(tmp_path / "seven.raw")
    (tmp_path / "no.tif").write_text("no image")
    file = {"file": {"value": "seven.raw"}, "type": "int16"}
    data["detector"]["bad_pixel_map"] = file
    size = {axis: quantity(1.0, "mm") for axis in "uv"}
    data["source"]["spot"] = {"size": size, "intensity_map": {"file": {"value": "no.tif"}}}
    found = problems_of(write(data))
    assert [problem.split(": ")[0] for problem in found] == [
        "source.spot.intensity_map.file",
        "detector.bad_pixel_map.file",
    ]
    data["detector"]["bad_pixel_map"] = None
    data["source"]["spot"]["intensity_map"] = dict(file)
    assert problems_of(write(data)) == [
        "source.spot.intensity_map.dim_x, dim_y: a raw file needs both"
    ]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"file": \n oops', "broken.json:2: not valid JSON: Expecting value at column 2"),
        ('{"file', "broken.json:1: not valid JSON: Unterminated string starting at column 2"),
        ("", "broken.json: the file is empty"),
        ("[1]", "broken.json: a CTSimU scenario must be a JSON object"),
        ("[" * 100_000, "broken.json: not valid JSON: "),
        ('{"a": ' + "1" * 5000 + "}", "broken.json: not valid JSON: "),
        ('{"a": [{"b": 1, "b": 2}], "a": [{"b": 1, "b": 2}]}', "broken.json: a: is given twice"),
        ('{"a": [{"b": 1, "b": 2}]}', "broken.json: a[0].b: is given twice"),
    ],
    ids=lambda v: v[:20],
)
def test_broken_file_is_named(tmp_path, text, words):
    (tmp_path / "broken.json").write_text(text)
    with pytest.raises(ScenarioError) as refused:
        load_ctsimu(tmp_path / "broken.json")
    assert words in str(refused.value)


def test_file_that_is_no_text_is_named(tmp_path):
    (tmp_path / "latin.json").write_bytes('{"name": "Röhre"}'.encode("latin-1"))
    with pytest.raises(ScenarioError, match=r"latin.json: the scenario cannot be read: not UTF-8"):
        load_ctsimu(tmp_path / "latin.json")


def test_thousands_of_wrong_keys_are_counted_with_little_work(data, write, monkeypatch) -> None:
    looked_up: list[str] = []
    near = difflib.get_close_matches

    def counted(key: str, *given, **keys) -> list[str]:
        looked_up.append(key)
        return near(key, *given, **keys)

    monkeypatch.setattr(difflib, "get_close_matches", counted)
    data |= {f"k{i}": 1 for i in range(3000)}
    data["detector"]["columns"] |= {f"k{i}": 1 for i in range(3000)}
    with pytest.raises(ScenarioError) as caught:
        load_ctsimu(write(data))
    assert len(caught.value.problems) == 6000 and len(looked_up) < 500
    assert str(caught.value).endswith("\nand 5990 more problems")
    text = ", ".join(f'"k{i % 2000}": 1' for i in range(4000))
    path = write(data)
    path.write_text(f"{{{text}}}")
    with pytest.raises(ScenarioError, match="k0: is given twice") as caught:
        load_ctsimu(path)
    assert len(caught.value.problems) == 2000
