"""Robot descriptions (URDF) with more than one arm, reduced to the chain from root to flange."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

from twinct.core.errors import ScenarioError
from twinct.core.foreign_text import quoted

FLANGE_LINKS = ("tool0", "flange")
"""Names of the flange in URDF; by ROS's REP 199, z of ``tool0`` and x of ``flange`` point away."""

CONTINUOUS_RAD = 2 * math.pi
"""Range of a ``continuous`` joint on either side, which has none of its own."""

_MOVING = ("revolute", "continuous", "prismatic", "floating", "planar")
_OF_MOTION = ("axis", "limit", "mimic", "dynamics", "safety_controller", "calibration")


@dataclass(frozen=True)
class Reduced:
    """One arm of a robot description.

    Attributes:
        text: URDF in which only the joints from root to flange move.
        notes: changes, in words.
    """

    text: str
    notes: tuple[str, ...]


def arm_alone(text: str, wanted: str | None, where: str) -> Reduced:
    """Hold all joints still that are not between root and flange, such as those of grippers.

    Args:
        text: URDF.
        wanted: link at the flange; None stands for the usual names.
        where: name of the URDF in messages.

    Raises:
        ScenarioError: a joint beside the arm follows one of the arm's joints.
    """
    root = ElementTree.fromstring(text)
    joints = {_link(joint, "child"): joint for joint in root.findall("joint")}
    flange = flange_link(root, wanted)
    if flange is None:  # reported when the flange is looked up in the model
        return Reduced(text, ())
    way: list[Any] = []
    while (joint := joints.get(flange)) is not None and joint not in way:
        way.append(joint)
        flange = _link(joint, "parent")
    endless = [joint for joint in reversed(way) if joint.get("type") == "continuous"]
    for joint in endless:
        _limit(joint)
    beside = [joint for joint in root.findall("joint") if joint not in way]
    _check_mimics(beside, {joint.get("name") for joint in way}, where)
    held = [joint for joint in beside if joint.get("type") in _MOVING]
    for joint in held:
        joint.set("type", "fixed")
        for element in [element for element in joint if element.tag in _OF_MOTION]:
            joint.remove(element)
    results = {
        "held still at 0, as not between base and flange": held,
        "range of +-360 deg for continuous joints": endless,
    }
    notes = (f"{what}: {_named(of)}" for what, of in results.items() if of)
    return Reduced(ElementTree.tostring(root, encoding="unicode"), tuple(notes))


def _check_mimics(beside: list[Any], names: set[str | None], where: str) -> None:
    """Refuse joints beside the arm that follow one of its joints."""
    for joint in beside:
        mimic = joint.find("mimic")
        if mimic is not None and mimic.get("joint") in names:
            raise ScenarioError(
                f"{where}: joint {quoted(joint.get('name', ''))} lies beside the arm and follows "
                f"its joint {quoted(mimic.get('joint', ''))} (mimic): linkages that move along are "
                "not modelled; remove the joint with its links"
            )


def _named(joints: list[Any]) -> str:
    return ", ".join(joint.get("name", "") for joint in joints)


def flange_link(root: Any, wanted: str | None) -> str | None:
    """Return the name of the flange's link, None if the description has none."""
    links = [link.get("name") for link in root.findall("link")]
    return next((name for name in ((wanted,) if wanted else FLANGE_LINKS) if name in links), None)


def _link(joint: Any, role: str) -> str:
    element = joint.find(role)
    return "" if element is None else element.get("link", "")


def _limit(joint: Any) -> None:
    """Give a continuous joint a range; effort and velocity stay."""
    limit = joint.find("limit")
    if limit is None:
        limit = ElementTree.SubElement(joint, "limit")
    joint.set("type", "revolute")
    limit.set("lower", repr(-CONTINUOUS_RAD))
    limit.set("upper", repr(CONTINUOUS_RAD))
