"""Reach of the arms, their best placement, and the diagnosis of infeasible views."""

from twinct.reach.holding import Holder, Poses
from twinct.reach.place import Bounds, Placement, place
from twinct.reach.sphere import Reach, poses_of, reach
from twinct.reach.why import View, reasons, shown

__all__ = [
    "Bounds",
    "Holder",
    "Placement",
    "Poses",
    "Reach",
    "View",
    "place",
    "poses_of",
    "reach",
    "reasons",
    "shown",
]
