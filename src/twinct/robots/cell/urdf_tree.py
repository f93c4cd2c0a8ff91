"""Robot descriptions (URDF) with more than one arm, reduced to the chain from root to flange."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree

from twinct.robots.cell.urdf_inertia import repair_inertia

FLANGE_LINKS = ("tool0", "flange")
"""Names of the flange in URDF; by ROS's REP 199, z of ``tool0`` and x of ``flange`` point away."""

CONTINUOUS_RAD = 2 * math.pi
"""Range of a ``continuous`` joint on either side, which has none of its own."""

LEAST_HINGES = 5
"""Number of hinges after which an arm may end."""

_MOVING = ("revolute", "continuous", "prismatic", "floating", "planar")
_OF_MOTION = ("axis", "limit", "mimic", "dynamics", "safety_controller", "calibration")


@dataclass(frozen=True)
class Reduced:
    """One arm of a robot description.

    Attributes:
        text: URDF in which only the joints from root to flange move.
        notes: changes, in words.
        linkages: links that joints carry which follow the arm's joints, and now stand still.
        disabled: pairs of links whose collisions the description disables.
    """

    text: str
    notes: tuple[str, ...]
    linkages: tuple[str, ...] = ()
    disabled: tuple[tuple[str, str], ...] = ()


def arm_alone(text: str, wanted: str | None) -> Reduced:
    """Hold all joints still that are not between root and flange, such as those of grippers.

    Args:
        text: URDF.
        wanted: link at the flange; None stands for the usual names, or the end of the tree.
    """
    root = ElementTree.fromstring(text)
    disabled = tuple(_disabled(root))
    notes = repair_inertia(root)
    way = way_to_flange(root, wanted)
    endless = [joint for joint in way if joint.get("type") == "continuous"]
    for joint in endless:
        _limit(joint)
    held: list[Any] = []
    followers: list[Any] = []
    names = {joint.get("name") for joint in way}
    for joint in root.findall("joint") if way else ():
        if joint in way or joint.get("type") not in _MOVING:
            continue
        mimic = joint.find("mimic")
        follows = mimic is not None and mimic.get("joint") in names
        (followers if follows else held).append(joint)
    for joint in (*held, *followers):
        joint.set("type", "fixed")
        for element in [element for element in joint if element.tag in _OF_MOTION]:
            joint.remove(element)
    results = {
        "held still at 0, as not between base and flange": held,
        "held still at 0, although they follow the arm (mimic), and not checked against it": (
            followers
        ),
        "range of +-360 deg for continuous joints": endless,
    }
    notes += tuple(f"{what}: {_named(of)}" for what, of in results.items() if of)
    linkages = tuple(link for joint in followers for link in _below(root, _link(joint, "child")))
    return Reduced(ElementTree.tostring(root, encoding="unicode"), notes, linkages, disabled)


def way_to_flange(root: Any, wanted: str | None) -> list[Any]:
    """Return the joints from root to flange; none if the description has no such flange.

    Args:
        root: description.
        wanted: link at the flange; None stands for a usual name, or else the end of the tree.
    """
    joints = {_link(joint, "child"): joint for joint in root.findall("joint")}
    link = flange_link(root, wanted)
    if link is None and not wanted:
        link = _end_of_tree(root)
    way: list[Any] = []
    while link is not None and (joint := joints.get(link)) is not None and joint not in way:
        way.append(joint)
        link = _link(joint, "parent")
    return way[::-1]


def _end_of_tree(root: Any) -> str | None:
    """Return the link after the last hinge of the longest chain of hinges.

    A tool that branches, such as the fingers of a gripper, begins where an arm that is complete has
    more than one way on.
    """
    below: dict[str, list[Any]] = {}
    for joint in root.findall("joint"):
        below.setdefault(_link(joint, "parent"), []).append(joint)
    children = {_link(joint, "child") for joint in root.findall("joint")}
    best: tuple[int, str | None] = (0, None)
    starts = [link.get("name", "") for link in root.findall("link")]
    pending = [(name, 0, False) for name in starts if name not in children]
    seen: set[str] = set()
    while pending:
        name, hinges, grips = pending.pop(0)
        if name in seen:  # a loop
            continue
        seen.add(name)
        onwards = [joint for joint in below.get(name, ()) if joint.get("type") in _MOVING]
        grips = grips or (hinges >= LEAST_HINGES and len(onwards) > 1)
        for joint in below.get(name, ()):
            child, hinge = _link(joint, "child"), _is_hinge(joint)
            if hinge and not grips:
                best = max(best, (hinges + 1, child), key=lambda one: one[0])
            if hinge or joint.get("type") not in _MOVING:
                pending.append((child, hinges + hinge, grips))
    return best[1]


def _is_hinge(joint: Any) -> bool:
    return joint.get("type") in ("revolute", "continuous") and joint.find("mimic") is None


def _below(root: Any, link: str) -> list[str]:
    """Return a link and all links that it carries."""
    links = [link]
    for name in links:
        links += [
            _link(joint, "child")
            for joint in root.findall("joint")
            if _link(joint, "parent") == name and _link(joint, "child") not in links
        ]
    return links


def _disabled(root: Any) -> Iterator[tuple[str, str]]:
    """Remove and yield the pairs of links that twinct arm took from an SRDF."""
    for element in root.findall("disable_collisions"):
        root.remove(element)
        yield element.get("link1", ""), element.get("link2", "")


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
