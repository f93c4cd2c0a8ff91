"""Zone of the sphere: between two latitudes, over an arc of longitude."""

from __future__ import annotations

import numpy as np
from pydantic import model_validator

from twinct.core.settings import Conflict, ConflictError, Finite, Section, setting
from twinct.geometry import Floats


class LatitudeZone(Section):
    """Keys of a path that fills a zone."""

    latitude_range_deg: tuple[Finite, Finite] = setting(
        (-60.0, 60.0), "Lowest and highest latitude, -90 to 90."
    )

    @model_validator(mode="after")
    def _in_order(self) -> LatitudeZone:
        low, high = self.latitude_range_deg
        if not -90 <= low < high <= 90:
            message = (
                f"latitude_range_deg ({low:g}, {high:g}) must be two latitudes from -90 to 90, "
                "the lower one first"
            )
            raise ConflictError(Conflict(message, ("latitude_range_deg",)))
        return self

    def heights(self, share: Floats) -> Floats:
        """Return latitudes that have shares of the zone's area below, rad (Archimedes' hat box)."""
        low, high = np.sin(np.radians(self.latitude_range_deg))
        return np.arcsin(low + (high - low) * share)
