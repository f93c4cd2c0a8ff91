"""Judgement: the region every view sees, the image in it, and how well the arms arrived."""

from twinct.evaluate.image import ImageFigures, image_figures
from twinct.evaluate.pose import ArmErrors, PoseErrors, pose_errors, tool_speeds
from twinct.evaluate.region import region_of_interest
from twinct.evaluate.sight import Sight, sight

__all__ = [
    "ArmErrors",
    "ImageFigures",
    "PoseErrors",
    "Sight",
    "image_figures",
    "pose_errors",
    "region_of_interest",
    "sight",
    "tool_speeds",
]
