"""A breathing patient in the views: the voxels of a grey part in their state at each instant."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twinct.specimen.body_motion import BodyMotion
from twinct.specimen.breathing import Breath
from twinct.specimen.grey_caster import GreyCaster
from twinct.specimen.part import Caster, Part


class MovingVoxels:
    """Voxels that a caster sees, moved to a state of breathing before each image."""

    def __init__(self, motion: BodyMotion, caster: GreyCaster, exposure_s: float) -> None:
        """Take the motion, the caster of the moving part, and the duration of an exposure."""
        self._motion, self._caster, self._exposure_s = motion, caster, exposure_s
        self._amounts: NDArray[np.float32] | None = None
        self._breath: Breath | None = None

    def show(self, time_s: float, number: int, count: int) -> None:
        """Show the patient at one of ``count`` instants of an exposure whose middle is given."""
        share = (number + 0.5) / count - 0.5
        breath = self._motion.at(time_s + share * self._exposure_s)
        if breath == self._breath:
            return
        if self._amounts is None:
            self._amounts = np.empty_like(self._caster.field.amounts)
        self._motion.pull(self._caster.field, breath, self._amounts)
        self._caster.show(self._amounts)
        self._breath = breath


def moving_voxels(
    motion: BodyMotion, parts: Sequence[Part], casters: Sequence[Caster], exposure_s: float
) -> MovingVoxels:
    """Return the voxels of the moving part among parts with their casters."""
    moving = (c for part, c in zip(parts, casters, strict=True) if part.name == motion.part)
    caster = next(one for one in moving if isinstance(one, GreyCaster))
    return MovingVoxels(motion, caster, exposure_s)
