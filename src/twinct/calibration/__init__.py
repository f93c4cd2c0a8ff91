"""Executed geometry of a scan, estimated from balls at known positions or from the scan itself."""

from twinct.calibration.beads import BallCalibration, calibrated, calibrated_view
from twinct.calibration.bundle import BundleAdjustment, bundled
from twinct.calibration.circle_found import circle_found
from twinct.calibration.circular import (
    CircleNumbers,
    CircularCalibration,
    CircularPrior,
    Undetermined,
    circle_numbers,
    circular_consistent,
)
from twinct.calibration.consistency import Round, SelfCalibration, self_calibrated
from twinct.calibration.epipolar import EpipolarConsistency, epipolar_consistent
from twinct.calibration.freedom import PosePrior, What
from twinct.calibration.kinematics import (
    ArmPrior,
    KinematicCalibration,
    PhantomViews,
    UndeterminedByArm,
    calibrated_arms,
)
from twinct.calibration.modes import Aligned, aligned
from twinct.calibration.online import OnlineCalibration, online_calibrated
from twinct.calibration.phantom import BallPhantom
from twinct.calibration.resection import PARAMETERS, Resection, moved, resected
from twinct.calibration.shadows import Shadows, measured, spots
from twinct.calibration.tracks import Tracks, tracked
from twinct.robots.calibrated_arms import (
    ArmDeviations,
    CalibratedArms,
    frames_of,
    require_same_arms,
)

__all__ = [
    "tracked",
    "Tracks",
    "online_calibrated",
    "OnlineCalibration",
    "bundled",
    "BundleAdjustment",
    "PARAMETERS",
    "Aligned",
    "ArmPrior",
    "BallCalibration",
    "BallPhantom",
    "CalibratedArms",
    "ArmDeviations",
    "CircleNumbers",
    "CircularCalibration",
    "CircularPrior",
    "EpipolarConsistency",
    "KinematicCalibration",
    "PhantomViews",
    "PosePrior",
    "Resection",
    "Round",
    "SelfCalibration",
    "Shadows",
    "Undetermined",
    "UndeterminedByArm",
    "What",
    "aligned",
    "calibrated",
    "calibrated_arms",
    "calibrated_view",
    "circle_found",
    "circle_numbers",
    "circular_consistent",
    "epipolar_consistent",
    "frames_of",
    "measured",
    "moved",
    "require_same_arms",
    "resected",
    "self_calibrated",
    "spots",
]
