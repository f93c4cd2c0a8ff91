"""All trajectory families by name, built in or from extensions."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Annotated, Any, Union

from pydantic import Field

from twinct.core.extensions import Registry
from twinct.core.settings import OneOf, complete, kind_of
from twinct.geometry import Floats, Panel, ScanGeometry
from twinct.trajectory.arc import ARC
from twinct.trajectory.circle import CIRCLE
from twinct.trajectory.circle_arc import CIRCLE_ARC
from twinct.trajectory.family import Family, TrajectorySettings
from twinct.trajectory.helix import HELIX
from twinct.trajectory.saddle import SADDLE
from twinct.trajectory.sinusoid import SINUSOID
from twinct.trajectory.spiral import SPIRAL
from twinct.trajectory.table import FILE
from twinct.trajectory.uniform import UNIFORM

_ALL = (SINUSOID, CIRCLE, ARC, CIRCLE_ARC, SADDLE, SPIRAL, UNIFORM, HELIX, FILE)
BUILT_IN = {family.name: family for family in _ALL}


@cache
def families() -> Registry[Family]:
    """Return the families that a scenario can name; they are looked up once per process."""
    known = Registry("twinct.trajectories", Family, BUILT_IN)
    known.keep(lambda family: complete(family.settings), "the settings of {name}")
    return known


def _sections() -> Any:
    return Annotated[
        Union[tuple(family.settings for family in families().values())],  # noqa: UP007
        Field(discriminator="kind"),
    ]


if TYPE_CHECKING:

    class AnyTrajectory(TrajectorySettings):
        """Keys that all trajectories share."""

        kind: str

else:
    AnyTrajectory = Annotated[TrajectorySettings, OneOf(_sections)]


def commanded_views(section: TrajectorySettings, panel: Panel) -> ScanGeometry:
    """Return the geometry that a trajectory commands.

    Raises:
        TrajectoryError: a file of views cannot be read, or contains an invalid view.
    """
    return families()[kind_of(type(section))].views(section, panel)


def leaves_roll(section: TrajectorySettings) -> bool:
    """Return True if a trajectory leaves the panel's rotation about its normal open.

    Raises:
        TrajectoryError: a file of views cannot be read.
    """
    return families()[kind_of(type(section))].leaves_roll(section)


def commanded_mas(section: TrajectorySettings) -> Floats | None:
    """Return the tube load that a trajectory commands for each view, (views,), mAs, or None.

    Raises:
        TrajectoryError: a file of views cannot be read.
    """
    return families()[kind_of(type(section))].mas(section)
