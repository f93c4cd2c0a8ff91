"""Where source and detector really were: from balls at known places, or the scan itself."""

from twinct.calibration.beads import BallCalibration, calibrated, calibrated_view
from twinct.calibration.consistency import (
    PosePrior,
    Round,
    SelfCalibration,
    What,
    self_calibrated,
)
from twinct.calibration.modes import Aligned, aligned
from twinct.calibration.phantom import BallPhantom
from twinct.calibration.resection import PARAMETERS, Resection, moved, resected
from twinct.calibration.shadows import Shadows, measured, spots

__all__ = [
    "PARAMETERS",
    "Aligned",
    "BallCalibration",
    "BallPhantom",
    "PosePrior",
    "Resection",
    "Round",
    "SelfCalibration",
    "Shadows",
    "What",
    "aligned",
    "calibrated",
    "calibrated_view",
    "measured",
    "moved",
    "resected",
    "self_calibrated",
    "spots",
]
