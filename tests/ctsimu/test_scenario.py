"""Reading: geometry against BAM's own toolbox, units and drifts by hand, refusals by name."""

from __future__ import annotations

import numpy as np
import pytest

from twinct.ctsimu import load_ctsimu
from twinct.ctsimu.reader import Moment, Section
from twinct.ctsimu.writing import quantity, vector
from twinct.errors import ScenarioError

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
        body = frame.bodies[0].world_from_body
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
    section = Section({"x": parameter}, "", Moment(frame, 4), tmp_path, [])
    assert section.number("x", unit) == pytest.approx(expected)
    assert not section.problems


def test_text_drifts_hold_until_the_next(tmp_path):
    data = {"file": {"value": "a", "drifts": [{"value": ["b", "c"]}]}}
    found = [Section(data, "", Moment(i, 4), tmp_path, []).text("file") for i in range(4)]
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
        (("detector", "sharpness"), {"value": 1}, ["detector.sharpness", "not supported"]),
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


def test_broken_file_is_named(tmp_path):
    (tmp_path / "broken.json").write_text('{"file": \n oops')
    with pytest.raises(ScenarioError, match=r"broken.json:2: not valid JSON"):
        load_ctsimu(tmp_path / "broken.json")
