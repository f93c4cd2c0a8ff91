"""All families of trajectories by name: those of this package, and those of others."""

from __future__ import annotations

from functools import cache

from twinct.extensions import Offers, offers
from twinct.geometry import Floats, Panel, ScanGeometry
from twinct.trajectory.arc import ARC
from twinct.trajectory.circle import CIRCLE
from twinct.trajectory.circle_arc import CIRCLE_ARC
from twinct.trajectory.family import Family, TrajectorySettings, name_in
from twinct.trajectory.helix import HELIX
from twinct.trajectory.saddle import SADDLE
from twinct.trajectory.sinusoid import SINUSOID
from twinct.trajectory.spiral import SPIRAL
from twinct.trajectory.table import FILE
from twinct.trajectory.uniform import UNIFORM

_ALL = (SINUSOID, CIRCLE, ARC, CIRCLE_ARC, SADDLE, SPIRAL, UNIFORM, HELIX, FILE)
BUILT_IN = {family.name: family for family in _ALL}


@cache
def families() -> Offers[Family]:
    """Those that a scenario can name; looked up once in each process."""
    return offers("twinct.trajectories", Family, BUILT_IN)


def commanded_views(section: TrajectorySettings, panel: Panel) -> ScanGeometry:
    """The geometry a trajectory commands.

    Raises:
        TrajectoryError: a file of views that cannot be read, or a view that is none.
    """
    return families()[name_in(type(section))].views(section, panel)


def leaves_roll(section: TrajectorySettings) -> bool:
    """Whether a trajectory says nothing of the panel's turn about its normal.

    Raises:
        TrajectoryError: a file of views that cannot be read.
    """
    return families()[name_in(type(section))].leaves_roll(section)


def commanded_mas(section: TrajectorySettings) -> Floats | None:
    """Tube load of each view that a trajectory commands, (views,), mAs; None: it says none.

    Raises:
        TrajectoryError: a file of views that cannot be read.
    """
    return families()[name_in(type(section))].mas(section)
