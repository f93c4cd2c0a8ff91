"""Poses of views at which the specimen stands still."""

from dataclasses import replace

from twinct.geometry import Pose, ScanGeometry
from twinct.geometry.wire import PosePairs


def posed(views: ScanGeometry, *specimen: Pose) -> PosePairs:
    """Poses of views, and of the specimen in each: where it is built, if not given."""
    return replace(
        PosePairs.from_geometry(views), object=specimen or (Pose.identity(),) * len(views)
    )
