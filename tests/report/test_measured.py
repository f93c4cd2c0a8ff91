"""Figures that a scenario asks for, as the report shows them."""

from twinct.report.measured import (
    curve_pictures,
    curves_picture,
    depth_picture,
    measured_rows,
    nested,
    reasons,
)

CURVE = {"frequency_per_mm": [0.0, 0.5, 1.0], "mtf": [1.0, 0.6, 0.2]}
COLUMNS = {
    "believed geometry": {
        "rmse_rel_by_depth": {"0_to_5_mm": 0.2, "5_to_10_mm": None, "beyond_10_mm": 0.1},
        "contrasts": {"a_against_b": {"contrast_rel": 0.1, "recovery": None, "cnr": 2.5}},
        "mtf": {"ball": {"f50_per_mm": 0.6, "f10_per_mm": None, **CURVE}},
    },
    "beside": {"mtf": {"ball": {"f50_per_mm": 0.4, "f10_per_mm": 0.9, **CURVE}}},
}


def test_a_row_for_each_figure_and_a_value_for_each_volume() -> None:
    rows = measured_rows(COLUMNS, "steel")
    assert [(where, one.key, values) for where, one, values in rows] == [
        ("a against b", "contrast_rel", [0.1, None]),
        ("a against b", "recovery", [None, None]),
        ("a against b", "cnr", [2.5, None]),
        ("whole volume", "edge_width_mm", [None, None]),
        ("ball", "f50_per_mm", [0.6, 0.4]),
        ("ball", "f10_per_mm", [None, 0.9]),
        ("ball", "shift_mm", [None, None]),
    ]
    assert "of μ(steel)" in rows[0][1].meaning
    assert measured_rows({"one": {"rmse_rel": 1.0}}, "bone") == []


def test_reasons_are_given_where_figures_have_no_value() -> None:
    columns = {"good": {"signal_rel": 0.9}, "empty": {"signal_rel": 0.0}, "older": {"rmse_rel": 1}}
    columns["unsure"] = {"signal_rel": 0.52, "signal_error_rel": 0.02}
    empty, older, unsure = reasons(columns)
    assert empty.startswith("empty: the volume has 0.0 % of the truth's contrast")
    assert unsure.startswith(
        "unsure: the volume has 52.0 % of the truth's contrast, give or take 2"
    )
    assert older.startswith("older: its signal is unknown")


def test_a_name_that_leads_nowhere_has_no_value() -> None:
    assert nested(COLUMNS["beside"], "mtf.ball.f50_per_mm") == 0.4
    assert nested(COLUMNS["beside"], "mtf.rod.f50_per_mm") is None
    assert nested({"mtf": None}, "mtf.rod") is None


def test_pictures_are_there_where_something_was_measured() -> None:
    edges = (5.0, 10.0)
    drawn = depth_picture(COLUMNS, edges), curves_picture(COLUMNS, "mtf", "mtf", "MTF")
    for picture in drawn:
        assert picture is not None and picture.content.startswith(b"<?xml")
    assert depth_picture({"beside": COLUMNS["beside"]}, edges) is None
    assert curves_picture(COLUMNS, "nps", "nps_mm3", "power") is None
    assert depth_picture(COLUMNS, edges) == drawn[0], "the same bytes each time"
    (curves,) = curve_pictures(COLUMNS, "steel")
    assert (curves[0], curves[2]) == ("Modulation transfer", drawn[1])
    of_noise = {"frequency_per_mm": [0.0, 0.5], "nps_mm3": [1.0, 0.5]}
    ((title, caption, _),) = curve_pictures({"one": {"nps": {"water": of_noise}}}, "steel")
    assert title == "Noise power" and "relative to μ(steel)²" in caption
    without = {"one": {"mtf": {"ball": {"f50_per_mm": None, "f10_per_mm": None}}}}
    assert curves_picture(without, "mtf", "mtf", "MTF") is None
