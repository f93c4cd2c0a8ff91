"""The contract of metrics.json."""

import json
import math

import numpy as np
import pytest

from twinct.evaluation import ImageFigures, PoseErrors, ToolErrors
from twinct.report import build_metrics, plain

ERRORS = PoseErrors(
    ToolErrors(np.array([1.0, 3.0]), np.array([0.1, 0.2])),
    ToolErrors(np.array([5.0, 7.0]), np.array([0.3, 0.5])),
)
ZERO = {"rmse_rel": 0.3, "ssim": 0.7}
FURTHER = {"edge_width_mm": 1.5, "mtf": {"ball": {"f50_per_mm": 0.5, "mtf": np.ones(3)}}}
FIGURES = ImageFigures(0.1, 0.2, 20.0, 0.9, 0.99, 0.4, 0.1, 0.8, ZERO, FURTHER)
SECONDS = {"plan": 1.0, "motion": 4.0, "xray": 2.0, "reconstruction": 8.0, "total": 16.0}


def metrics(**changes):
    arguments = {
        "views": 3,
        "reached": 2,
        "pose_errors": ERRORS,
        "clearance_mm": np.array([12.0, 11.5]),
        "image": FIGURES,
        "seconds": SECONDS,
        "simulated_seconds": 100.0,
        "scenario_digest": "abc",
    }
    return build_metrics(**(arguments | changes))


def leaves(data, path=""):
    for key, value in data.items():
        if isinstance(value, dict):
            yield from leaves(value, f"{path}{key}.")
        else:
            yield f"{path}{key}"


def test_keys_are_those_that_scripts_rely_on():
    contract = {"views", "reached", "clearance_mm.min", "simulated_seconds", "real_time_factor"}
    contract |= {
        f"pose_error.{arm}.{kind}.{figure}"
        for arm in ("source", "detector")
        for kind in ("position_mm", "rotation_deg")
        for figure in ("mean", "std", "max")
    }
    contract |= {
        f"image.{name}"
        for name in (
            "rmse_rel rmse_near_rel psnr_db ssim mean_reference_rel roi_fraction "
            "roi_reference_fraction ssim_near signal_rel signal_error_rel zero.rmse_rel zero.ssim "
            "edge_width_mm mtf.ball.f50_per_mm mtf.ball.mtf"
        ).split()
    }
    contract |= {
        f"seconds.{stage}" for stage in ("plan", "motion", "xray", "reconstruction", "total")
    }
    assert set(leaves(metrics())) == contract | {"twinct_version", "scenario_digest"}


def test_values_land_under_their_names():
    result = metrics()
    assert (result["views"], result["reached"]) == (3, 2)
    assert result["pose_error"]["source"]["position_mm"] == {"mean": 2.0, "std": 1.0, "max": 3.0}
    assert result["pose_error"]["detector"]["rotation_deg"]["max"] == 0.5
    assert result["clearance_mm"]["min"] == 11.5
    assert result["image"]["psnr_db"] == 20.0
    assert result["real_time_factor"] == 25.0, "simulated seconds over those of the motion"
    assert metrics(real_time_factor=7.0)["real_time_factor"] == 7.0


def test_several_geometries_stand_side_by_side():
    further = FURTHER | {"edge_width_mm": 1.25, "nps": {"brain": {"noise_rel": 0.1}}}
    other = ImageFigures(0.05, 0.1, 26.0, 0.95, 1.0, 0.4, 0.1, 0.85, ZERO, further)
    result = metrics(image={"believed": FIGURES, "executed": other})
    assert result["image"] == plain(FIGURES.as_dict()), "the first one's volume is kept"
    difference = result["believed_minus_executed"]
    assert difference["rmse_rel"] == 0.05 and difference["psnr_db"] == -6.0
    assert difference["edge_width_mm"] == 0.25 and difference["mtf"] == {"ball": {"f50_per_mm": 0}}
    assert "nps" not in difference and "zero" not in difference
    assert "believed_minus_executed" not in metrics()
    assert list(result["image_by_geometry"]) == ["believed", "executed"]
    assert result["image_by_geometry"]["executed"]["rmse_rel"] == 0.05
    assert "image_by_geometry" not in metrics(image={"believed": FIGURES})


def test_strict_json_even_where_a_figure_is_not_finite():
    perfect = ImageFigures(0.0, math.nan, math.inf, 1.0, math.nan, 0.4, 0.0)
    numpy_seconds = {name: np.float32(value) for name, value in SECONDS.items()}
    result = metrics(image=perfect, seconds=numpy_seconds, views=np.int64(3))
    assert json.loads(json.dumps(result, allow_nan=False)) == result
    assert result["image"]["psnr_db"] is None and result["image"]["rmse_near_rel"] is None
    assert metrics(seconds=SECONDS | {"motion": 0.0})["real_time_factor"] is None


def test_refusals():
    with pytest.raises(ValueError, match="seconds lacks motion, total"):
        metrics(seconds={"plan": 1, "xray": 1, "reconstruction": 1})
    with pytest.raises(ValueError, match="image holds no figures"):
        metrics(image={})
    with pytest.raises(ValueError, match="extra keys image_by_geometry are taken"):
        metrics(image={"believed": FIGURES, "executed": FIGURES}, image_by_geometry={})
    assert metrics(reconstruction_digest="xyz")["reconstruction_digest"] == "xyz"
