"""Errors of source and panel that differ from view to view, with arms or a gantry."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from twinct.uncertainty.error_terms import ErrorTerm, Spread, ToolMotion
from twinct.uncertainty.sections import ViewErrors


def _spreads(section: ViewErrors, motion: ToolMotion) -> Iterator[Spread]:
    if motion.side == "source":
        sigma = np.array([section.source_mm] * 3 + [0.0] * 3)
    else:
        tilt, turn = np.radians([section.detector_tilt_deg, section.detector_turn_deg])
        plane, normal = section.detector_in_plane_mm, section.detector_normal_mm
        sigma = np.array([plane, plane, normal, tilt, tilt, turn])
    yield Spread("pose", sigma, length=section.correlation_views)


VIEWS = ErrorTerm("views", ViewErrors, _spreads, purpose="view")
