"""Immutable events that observers of a run receive."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from twinct.geometry.wire import JointSample, PosePairs

if TYPE_CHECKING:
    from twinct.recon.volume import Volume
    from twinct.robots.motion import MotionPlan
    from twinct.scan import View
    from twinct.scenario import Scenario


@dataclass(frozen=True, eq=False)
class PlanMade:
    """The scan to come, reported before anything moves.

    Attributes:
        scenario: scenario of the run.
        commanded: poses of all views.
        plan: the arms' motion plan; None for a gantry, or if they solve each target as it comes.
    """

    scenario: Scenario
    commanded: PosePairs
    plan: MotionPlan | None


@dataclass(frozen=True, eq=False)
class ViewStored:
    """A view that is on disk, or in memory if there is no store.

    Attributes:
        index: index of the view, from 0.
        views: number of views of the scan.
        view: its image, read-only, and the robots' state.
    """

    index: int
    views: int
    view: View


@dataclass(frozen=True, eq=False)
class IterationDone:
    """An iteration of a reconstruction.

    Attributes:
        algorithm: its name.
        geometry: name of the geometry used.
        iteration: number, from 1.
        iterations: total number.
        residual: root mean square of p - A x, taken during the iteration before each update.
        volume: resulting volume, 1/mm; a read-only copy.
    """

    algorithm: str
    geometry: str
    iteration: int
    iterations: int
    residual: float
    volume: Volume


@dataclass(frozen=True)
class StageBegan:
    """Start of a stage of work.

    Attributes:
        name: name for users.
        total: number of steps.
        done: steps done before a resumption.
    """

    name: str
    total: int
    done: int


@dataclass(frozen=True)
class StageStep:
    """Completion of ``done`` steps of a stage; of several queued steps, only the last remains."""

    name: str
    total: int
    done: int


@dataclass(frozen=True)
class StageEnded:
    """End of a stage after ``seconds``; ``broken`` if an exception ended it."""

    name: str
    total: int
    done: int
    seconds: float
    broken: bool


@dataclass(frozen=True)
class Said:
    """A message that the user should see at once."""

    text: str
    warning: bool


@dataclass(frozen=True)
class Missed:
    """Events that a slow observer has missed since its last delivery.

    Attributes:
        events: number of each kind, by class name.
        views: indices of the missed views, which are in the store.
    """

    events: Mapping[str, int]
    views: tuple[int, ...]


Event = (
    PlanMade
    | JointSample
    | ViewStored
    | IterationDone
    | StageBegan
    | StageStep
    | StageEnded
    | Said
    | Missed
)
