"""Evaluation: the region that every view sees, the image in it, and the arms' accuracy."""

from twinct.evaluation.contrast import Contrast, contrast
from twinct.evaluation.depth import (
    DEPTHS_MM,
    RegionDepth,
    depth_names,
    region_depth,
    rmse_by_depth,
)
from twinct.evaluation.edges import Edges, edge_width, edges_of
from twinct.evaluation.figure import Figure
from twinct.evaluation.figure_kind import (
    Again,
    Curve,
    FigureKind,
    FigureSettings,
    Measurement,
    Repeated,
    RoundBody,
)
from twinct.evaluation.figure_kinds import figure_kinds
from twinct.evaluation.image import ImageFigures, ImageReference, image_figures
from twinct.evaluation.image_words import IMAGE_FIGURES, MOTION_FIGURES
from twinct.evaluation.mtf import Mtf, edge_mtf, edge_reach
from twinct.evaluation.nps import Nps, detrended, noise_power_spectrum
from twinct.evaluation.observer import DetectabilityIndex, detectability
from twinct.evaluation.pose import PoseErrors, ToolErrors, pose_errors, reprojection_px, tool_speeds
from twinct.evaluation.region_voxels import (
    VoxelSet,
    ball,
    centres,
    cuboid,
    cylinder,
    shell,
    whole,
)
from twinct.evaluation.streaks import around_axis, streak_index
from twinct.evaluation.visibility import Sight, coarse, sight
from twinct.geometry.region import region_of_interest, views_needed

__all__ = [
    "DEPTHS_MM",
    "Again",
    "ToolErrors",
    "Contrast",
    "DetectabilityIndex",
    "Edges",
    "ImageFigures",
    "ImageReference",
    "Mtf",
    "Nps",
    "PoseErrors",
    "RegionDepth",
    "Sight",
    "VoxelSet",
    "around_axis",
    "ball",
    "centres",
    "coarse",
    "contrast",
    "cuboid",
    "cylinder",
    "depth_names",
    "detectability",
    "detrended",
    "edge_mtf",
    "edge_reach",
    "edge_width",
    "edges_of",
    "image_figures",
    "noise_power_spectrum",
    "pose_errors",
    "region_depth",
    "region_of_interest",
    "reprojection_px",
    "rmse_by_depth",
    "shell",
    "whole",
    "sight",
    "streak_index",
    "tool_speeds",
    "views_needed",
    "Figure",
    "Curve",
    "FigureKind",
    "FigureSettings",
    "Measurement",
    "Repeated",
    "RoundBody",
    "figure_kinds",
    "IMAGE_FIGURES",
    "MOTION_FIGURES",
]
