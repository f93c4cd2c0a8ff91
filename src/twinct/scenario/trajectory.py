"""Where source and panel shall go: the settings of one family of trajectories."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Union

from pydantic import Field

from twinct.trajectory import TrajectorySettings
from twinct.trajectory.families import families

if TYPE_CHECKING:

    class AnyTrajectory(TrajectorySettings):
        """What all of them have."""

        kind: str

else:
    AnyTrajectory = Annotated[
        Union[tuple(family.settings for family in families().values())],  # noqa: UP007
        Field(discriminator="kind"),
    ]
