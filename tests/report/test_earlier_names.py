"""Figures of stored files of earlier versions, by today's names."""

from __future__ import annotations

from twinct.evaluation import IMAGE_FIGURES
from twinct.report.earlier_names import with_todays_names


def test_nested_figures_have_todays_names() -> None:
    then = {
        "image": {"rmse_bone_rel": 0.1, "zero": {"ssim_bone": None}, "edge_width_mm": 2.0},
        "reconstructions": {"fast": {"image": {"mean_bone_rel": 1.0}}},
    }
    now = with_todays_names(then)
    assert now["image"] == {"rmse_near_rel": 0.1, "zero": {"ssim_near": None}, "edge_width_mm": 2.0}
    assert now["reconstructions"]["fast"]["image"] == {"mean_reference_rel": 1.0}
    assert with_todays_names(now) == now


def test_dotted_figures_have_todays_names() -> None:
    then = {"image.zero.rmse_bone_rel": 0.1, "image.roi_bone_fraction": 0.2, "views": 3}
    now = {"image.zero.rmse_near_rel": 0.1, "image.roi_reference_fraction": 0.2, "views": 3}
    assert list(with_todays_names(then).items()) == list(now.items())


def test_a_region_may_have_the_name_of_a_figure_of_then() -> None:
    regions = {"regions": {"ssim_bone": {"mean_rel": 1.0}}, "image.regions.ssim_bone.rmse_rel": 0.1}
    assert with_todays_names(regions) == regions


def test_no_figure_says_bone_of_any_material() -> None:
    assert not [one for one in IMAGE_FIGURES if "bone" in one.key + one.title + one.meaning]
