"""The poses that the robots report of a scan."""

from __future__ import annotations

from twinct.scenario import Uncertainty
from twinct.uncertainty.evidence import Evidence
from twinct.uncertainty.repeatability import believed_poses
from twinct.views import PosePairs


def reported_poses(evidence: Evidence, uncertainty: Uncertainty, seed: int) -> PosePairs:
    """Executed poses with the noise of each view; other seeds are other reports of one scan."""
    executed = evidence.executed
    pairs = [
        believed_poses(*executed[view], uncertainty, seed, view) for view in range(len(executed))
    ]
    return PosePairs(tuple(source for source, _ in pairs), tuple(panel for _, panel in pairs))
