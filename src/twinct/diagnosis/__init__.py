"""Causes of line integrals that contradict each other: models of few numbers, ranked by a scan.

Each cause says how measured line integrals would differ from those of any volume. The part of this
difference that a volume could take over is removed, as it is from the scan's own residual; the rest
shows how much of the residual each cause explains.
"""

from twinct.diagnosis.diagnose import Diagnosis, diagnosed
from twinct.diagnosis.shares import Share

__all__ = ["Diagnosis", "Share", "diagnosed"]
