"""What separates believed from executed poses: models that are applied to a scan, after it."""

from twinct.uncertainty.evidence import Evidence
from twinct.uncertainty.repeatability import believed_poses
from twinct.uncertainty.reported import reported_poses

__all__ = ["Evidence", "believed_poses", "reported_poses"]
