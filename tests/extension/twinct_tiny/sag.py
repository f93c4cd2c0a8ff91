"""Source and panel sink under their weight, most where the beam is level."""

from collections.abc import Iterator

import numpy as np
from pydantic import Field

from twinct.uncertainty.error_terms import ErrorSettings, ErrorTerm, Spread, ToolMotion, size


class Sag(ErrorSettings):
    """Source and panel sink under their weight, most where the beam is level."""

    mm: float = size("Way down of a level beam.")
    spread: float = Field(default=0.1, ge=0, le=1, description="Its spread, as a share of mm.")


def _spreads(settings: Sag, motion: ToolMotion) -> Iterator[Spread]:
    turns = motion.poses[:, :3, :3]
    level = np.hypot(turns[:, 0, 2], turns[:, 1, 2])
    down = -settings.mm * level[:, None] * turns[:, 2]  # of the world, in the tool's axes
    twists = np.concatenate([down, np.zeros_like(down)], axis=1)
    yield Spread("pose", twists, draws="none")
    yield Spread("pose", settings.spread * twists, draws="side")


SAG = ErrorTerm("sag", Sag, _spreads)
