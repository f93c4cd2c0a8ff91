"""Trajectory families: their settings and their views.

Each family's file ends with its ``Family``. Families from outside the package come from the
entry points of the group ``twinct.trajectories``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from twinct.core.settings import Section, kind_of
from twinct.geometry import Floats, Panel, ScanGeometry


class TrajectorySettings(Section):
    """Keys of one family; ``kind`` is a Literal of its name.

    A key named ``path``, ``file`` or ``plan`` is an input file: its path is made absolute, it must
    exist, and its content counts.
    """


@dataclass(frozen=True, eq=False)
class Family:
    """Trajectory family that a scenario can name.

    Attributes:
        settings: class of its keys.
        views: commanded geometry, from settings and panel.
        leaves_roll: True if the settings leave the panel's rotation about its normal open.
        mas: tube load of each view, (views,), mAs, in the settings; None if not stated.
    """

    settings: type[TrajectorySettings]
    views: Callable[[Any, Panel], ScanGeometry]
    leaves_roll: Callable[[Any], bool] = lambda section: False
    mas: Callable[[Any], Floats | None] = lambda section: None

    @property
    def name(self) -> str:
        """Name of the family, the value of the key ``kind``."""
        return kind_of(self.settings)
