"""What observers of a run are told; nothing in an event can be changed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from twinct.views import JointSample, PosePairs

if TYPE_CHECKING:
    from twinct.motion import MotionPlan
    from twinct.scan import View
    from twinct.scenario import Scenario
    from twinct.volume import Volume


@dataclass(frozen=True, eq=False)
class PlanMade:
    """What is going to be scanned, before anything moves.

    Attributes:
        scenario: of the run.
        commanded: poses of all views.
        plan: what the arms follow; None where they solve each target as it comes, or with a gantry.
    """

    scenario: Scenario
    commanded: PosePairs
    plan: MotionPlan | None


@dataclass(frozen=True, eq=False)
class ViewStored:
    """A view that is on disk, or in memory where there is no store.

    Attributes:
        index: of the view, from 0.
        views: that the scan shall have.
        view: its image, read-only, and what the robots had.
    """

    index: int
    views: int
    view: View


@dataclass(frozen=True, eq=False)
class IterationDone:
    """An iteration of a reconstruction.

    Attributes:
        algorithm: its name.
        geometry: name of the geometry that it works from.
        iteration: from 1.
        iterations: that there shall be.
        residual: root mean square of p - A x, taken during it before each update.
        volume: what it left, 1/mm; a copy, read-only.
    """

    algorithm: str
    geometry: str
    iteration: int
    iterations: int
    residual: float
    volume: Volume


@dataclass(frozen=True)
class StageBegan:
    """A stage of work.

    Attributes:
        name: for people.
        total: steps that it has.
        done: steps done before, where it goes on.
    """

    name: str
    total: int
    done: int


@dataclass(frozen=True)
class StageStep:
    """``done`` steps of a stage are done; of steps that wait to be told only the last is kept."""

    name: str
    total: int
    done: int


@dataclass(frozen=True)
class StageEnded:
    """A stage is over after ``seconds``; ``broken`` by an exception or whole."""

    name: str
    total: int
    done: int
    seconds: float
    broken: bool


@dataclass(frozen=True)
class Said:
    """Something that a user should know at once."""

    text: str
    warning: bool


@dataclass(frozen=True)
class Missed:
    """What an observer that was too slow has not been told since it was last told anything.

    Attributes:
        events: how many of each kind, by the name of its class.
        views: indices of the views among them; the store has them.
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
