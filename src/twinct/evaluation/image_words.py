"""Image figures that every run has, in words."""

from __future__ import annotations

from twinct.evaluation.depth import depth_names
from twinct.evaluation.figure import Figure, percent

_WINDOWS = "3-D, windows of 7³ voxels inside the region; 1 is best"
_NEAR = "of windows centred within 3 mm of {0}"
_EDGES = "10 to 90 % across edges of {0}, median"
_DEPTH = "of μ({0}), by the distance to the region's border"

IMAGE_FIGURES = (
    percent("rmse_rel", "RMSE", "of μ({0}), over the region", "lower", 1),
    percent("rmse_bone_rel", "RMSE near {0}", "of μ({0}), within 3 mm of {0}", "lower", 1),
    Figure("psnr_db", "PSNR", "dB", 1, 1, "peak is μ({0})", "higher"),
    Figure("ssim", "SSIM", meaning=_WINDOWS, best="higher"),
    Figure("ssim_bone", "SSIM near {0}", meaning=_NEAR, best="higher"),
    Figure("edge_width_mm", "edge width", "mm", 1, 2, _EDGES, "lower"),
    percent("mean_bone_rel", "mean {0}", "of μ({0}), voxels entirely in {0}", "one", 1),
    percent("roi_fraction", "region", "of the grid, seen by every view", "higher", 1),
    percent("roi_bone_fraction", "{0} in the region", "of the region's voxels", "higher", 1),
    *(
        percent(f"rmse_rel_by_depth.{name}", f"RMSE, {told} mm deep", _DEPTH, "lower", 1)
        for name in depth_names()
        for told in (name.removesuffix("_mm").replace("_", " "),)
    ),
)
