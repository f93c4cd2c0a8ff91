"""What a family of trajectories is: its settings and its views.

Each family's file ends with its ``Family``; those from outside the package are found by the entry
points of the group ``twinct.trajectories``.
"""

from __future__ import annotations

import typing
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from twinct.geometry import Floats, Panel, ScanGeometry
from twinct.settings import Section


class TrajectorySettings(Section):
    """Keys of one family, among them ``kind``, a Literal of its name.

    A key named ``path`` or ``file`` is an input file: it is made absolute, must exist, and counts
    by content.
    """


@dataclass(frozen=True, eq=False)
class Family:
    """A family as the scenario can name it.

    Attributes:
        settings: its keys.
        views: the geometry that these settings command, for a panel.
        leaves_roll: whether these settings say nothing of the panel's turn about its normal.
        mas: tube load of each view, (views,), mAs; None: these settings say nothing of it.
    """

    settings: type[TrajectorySettings]
    views: Callable[[Any, Panel], ScanGeometry]
    leaves_roll: Callable[[Any], bool] = lambda section: False
    mas: Callable[[Any], Floats | None] = lambda section: None

    @property
    def name(self) -> str:
        """What the key ``kind`` calls it."""
        return name_in(self.settings)


def name_in(settings: type[TrajectorySettings]) -> str:
    """The name that the key ``kind`` of some settings takes."""
    return str(typing.get_args(settings.model_fields["kind"].annotation)[0])
