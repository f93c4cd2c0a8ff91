"""Errors that separate executed from commanded poses, and believed poses from both."""

from twinct.uncertainty.executed import TrueCell
from twinct.uncertainty.repeatability import believed_poses
from twinct.uncertainty.reported import reported_poses

__all__ = ["TrueCell", "believed_poses", "reported_poses"]
