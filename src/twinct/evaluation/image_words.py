"""Image figures that every run has, in words."""

from __future__ import annotations

from twinct.evaluation.depth import depth_names
from twinct.evaluation.figure import Degradation, Figure, percent

_WINDOWS = "3-D, windows of 7³ voxels inside the region; 1 is best"
_NEAR = "of windows centred within 3 mm of {0}"
_EDGES = "10 to 90 % across edges of {0}, median"
_DEPTH = "of μ({0}), by the distance to the region's border"
_MOVING = "of μ({0}), over the voxels of the region that breathing moves by 2 mm or more"
_SIGNAL = "of the truth's: slope of the volume over the truth, in the region"

_OF_OBJECT: tuple[Degradation, ...] = ("noise", "blur", "smoothing", "shift", "contrast")
"""All: the figure describes the object and the views."""

IMAGE_FIGURES = (
    percent(
        "rmse_near_rel",
        "RMSE near {0}",
        "of μ({0}), within 3 mm of {0}",
        "lower",
        1,
        good="below 5 %",
        without_signal="worse",
        blind_to=(),
    ),
    Figure(
        "ssim_near",
        "SSIM near {0}",
        meaning=_NEAR,
        best="higher",
        good="above 0.8",
        without_signal="null",
        blind_to=("smoothing",),
        beside=("/signal_rel", "/edge_width_mm"),
    ),
    Figure(
        "edge_width_mm",
        "edge width",
        "mm",
        digits=2,
        meaning=_EDGES,
        best="lower",
        good="1 to 2 voxels",
        without_signal="null",
        blind_to=("noise", "contrast"),
    ),
    percent(
        "mean_reference_rel",
        "mean in {0}",
        "of μ({0}), voxels entirely in {0}",
        "one",
        1,
        good="98 to 102 %",
        without_signal="null",
        blind_to=("noise",),
    ),
    percent(
        "signal_rel",
        "signal",
        _SIGNAL,
        "one",
        1,
        good="95 to 105 %",
        without_signal="worse",
        blind_to=("noise",),
    ),
    percent(
        "rmse_rel",
        "RMSE",
        "of μ({0}), over the region",
        "lower",
        1,
        good="below 3 %",
        without_signal="worse",
        blind_to=("smoothing",),
    ),
    Figure(
        "psnr_db",
        "PSNR",
        "dB",
        digits=1,
        meaning="peak is μ({0})",
        best="higher",
        good="above 30 dB",
        without_signal="worse",
        blind_to=("smoothing",),
    ),
    Figure(
        "ssim",
        "SSIM",
        meaning=_WINDOWS,
        best="higher",
        good="far above that of zeros",
        without_signal="null",
        blind_to=("smoothing",),
        beside=("/signal_rel", "/edge_width_mm"),
    ),
    percent(
        "roi_fraction",
        "region",
        "of the grid, seen by every view, or by most",
        "higher",
        1,
        good="holds the whole object",
        without_signal="any",
        blind_to=_OF_OBJECT,
    ),
    percent(
        "roi_reference_fraction",
        "{0} in the region",
        "of the region's voxels",
        "higher",
        1,
        good="no goal: it describes the object",
        without_signal="any",
        blind_to=_OF_OBJECT,
    ),
    *(
        percent(
            f"rmse_rel_by_depth.{name}",
            f"RMSE, {told} mm deep",
            _DEPTH,
            "lower",
            1,
            good="alike at all depths",
            without_signal="null",
            blind_to=("smoothing",),
        )
        for name in depth_names()
        for told in (name.removesuffix("_mm").replace("_", " "),)
    ),
)
"""Figures of every run; those near the object come first, as most of a region may be air."""

MOTION_FIGURES = (
    percent(
        "rmse_moving_rel",
        "RMSE where it moves",
        _MOVING,
        "lower",
        1,
        good="close to that of a patient at rest",
        without_signal="worse",
        blind_to=("smoothing",),
    ),
)
"""Image figures of a patient who moves."""
