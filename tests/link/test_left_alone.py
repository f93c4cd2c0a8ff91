"""An X-ray node by itself tells when its robots node is gone, and does not wait in silence."""

from __future__ import annotations

from typing import Any

import pytest

pytest.importorskip("rclpy")

from twinct.geometry import Panel
from twinct.link.node import Diagnostics
from twinct.link.stamps import Epoch
from twinct.link.xray_node import XRayNode
from twinct.scenario import Scenario, stage_digests


class Heard:
    """A subscription with so many publishers."""

    publishers = 0

    def get_publisher_count(self) -> int:
        return self.publishers


class Out:
    def publish(self, message: Any) -> None:
        pass

    def get_subscription_count(self) -> int:
        return 1


class Station:
    name, participant = "xray", "00"

    def __init__(self) -> None:
        self.heard = Heard()

    def publisher(self, *_: Any, **__: Any) -> Out:
        return Out()

    def on_garbled(self, _: Any) -> None:
        pass

    def listen(self, *_: Any) -> Heard:
        return self.heard

    def listen_to_all(self, *_: Any) -> list[Heard]:
        return [self.heard, self.heard]


@pytest.mark.parametrize("in_a_scan", [False, True])
def test_the_end_of_the_robots_node_is_told_once(scenario: Scenario, in_a_scan: bool) -> None:
    station, told = Station(), list[str]()
    epoch = Epoch.of(stage_digests(scenario)["images"]) if in_a_scan else None
    diagnostics = Diagnostics(station, told.append)  # type: ignore[arg-type]
    node = XRayNode(station, diagnostics, None, Panel(4, 4, 1, 1), epoch)  # type: ignore[arg-type]
    for count in (0, 1, 1, 0, 0, 1, 0):
        station.heard.publishers = count
        node.connected()
    gone = "no node publishes /scan/reached any more"
    assert [text[: len(gone)] for text in told] == ([] if in_a_scan else [gone, gone])
