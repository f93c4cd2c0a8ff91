"""``/tf`` and ``/tf_static`` of a robots node."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from twinct.geometry.wire import PosePairs
from twinct.link.messages import ros_message
from twinct.link.participant import Station
from twinct.link.plain import transforms
from twinct.link.stamps import Stamp
from twinct.link.topics import TF, TF_STATIC

if TYPE_CHECKING:
    from twinct.robots.cell import LinkFrames

TURN_RAD = 0.1
"""Turn of all joints, by which links that move are told from those that stand."""


OF_INSTANTS = ("source", "detector", "specimen")
"""Frames that are told with the poses of an instant."""


class Frames:
    """Publisher of all links of the room, in ``world``."""

    def __init__(self, station: Station, links: LinkFrames, joints: int) -> None:
        """Publish the links that stand.

        Args:
            station: participant of the robots node.
            links: kinematics of the room.
            joints: number of joints.
        """
        self._links = links
        here, turned = links.at(np.zeros(joints)), links.at(np.full(joints, TURN_RAD))
        self._standing = {
            name for name, pose in here.items() if pose == turned[name] and name not in OF_INSTANTS
        }
        self._moving, standing = station.publisher(TF), station.publisher(TF_STATIC)
        still = {name: here[name] for name in self._standing}
        standing.publish(self._message(Stamp(0, 0), None, still))
        self._static = standing
        self._last: tuple[Stamp, PosePairs] | None = None

    @property
    def heard(self) -> bool:
        """True while somebody listens to the links that move."""
        return self._moving.get_subscription_count() > 0

    def tell(self, stamp: Stamp, joints: ArrayLike, instant: PosePairs) -> None:
        """Publish the links that move, source, panel, camera and specimen.

        Args:
            stamp: time of the joints.
            joints: rad, (n,).
            instant: poses of source, specimen and panel.
        """
        if self._last == (stamp, instant):
            return  # listeners complain about a frame that comes twice
        self._last = stamp, instant
        links = self._links.at(joints)
        moving = {name: pose for name, pose in links.items() if name not in self._standing}
        self._moving.publish(self._message(stamp, instant, moving))

    def _message(
        self, stamp: Stamp, instant: PosePairs | None, links: dict[str, tuple[float, ...]]
    ) -> object:
        return ros_message(TF.message_class, transforms(stamp, instant, links))
