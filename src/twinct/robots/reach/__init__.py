"""Reach of the arms, their best placement, and the diagnosis of infeasible views."""

from twinct.robots.reach.cures import CureSearch
from twinct.robots.reach.holding import Holder, TargetPoses
from twinct.robots.reach.place import Bounds, Placement, place
from twinct.robots.reach.remedy import Remedy
from twinct.robots.reach.search_limit import SearchLimit
from twinct.robots.reach.sphere import Reach, poses_of, reach
from twinct.robots.reach.why import HeldView, reasons, shown

__all__ = [
    "Bounds",
    "CureSearch",
    "Holder",
    "Placement",
    "TargetPoses",
    "Reach",
    "Remedy",
    "SearchLimit",
    "HeldView",
    "place",
    "poses_of",
    "reach",
    "reasons",
    "shown",
]
