"""Observers of a run: events, and their delivery without delaying the run."""

from twinct.geometry.wire import JointSample
from twinct.observers.audience import Audience, Observer, Observers, audience_of
from twinct.observers.events import (
    Event,
    IterationDone,
    Missed,
    PlanMade,
    Said,
    StageBegan,
    StageEnded,
    StageStep,
    ViewStored,
)

__all__ = [
    "Audience",
    "Event",
    "IterationDone",
    "JointSample",
    "Missed",
    "Observer",
    "Observers",
    "PlanMade",
    "Said",
    "StageBegan",
    "StageEnded",
    "StageStep",
    "ViewStored",
    "audience_of",
]
