"""A robots node without a scan, at rest: late subscribers hear where the arms stand, and when."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("rclpy")

from waiting import HANG_S

from twinct.link.node import Diagnostics
from twinct.link.participant import Station
from twinct.link.robots_node import BEAT_S, RobotsNode
from twinct.link.stamps import Stamp
from twinct.link.topics import CLOCK, JOINTS, TF
from twinct.robots.cell import LinkFrames
from twinct.scan import SimulationBuilder
from twinct.scenario import load_scenario

pytestmark = pytest.mark.process

SCENARIO = {
    "trajectory": {"kind": "arc", "views": 4, "longitude_range_deg": 4},
    "specimen": {
        "parts": [{"shape": {"kind": "sphere", "radius_mm": 50, "mesh_resolution_mm": 8}}]
    },
    "detector": {"columns": 16, "rows": 12, "pixel_pitch_mm": 20},
}
BEATS = 40
ROUNDING_S = 1e-6


class Resting:
    """A node at rest, and a volatile subscriber that joins it late."""

    def __init__(self, domain: int) -> None:
        builder = SimulationBuilder(load_scenario(SCENARIO))
        self.robots = builder.robots()
        self.station, self._late = Station("robots", domain), Station("late", domain)
        diagnostics = Diagnostics(self.station, lambda _: None)
        self.node = RobotsNode(
            self.station,
            diagnostics,
            self.robots,
            description=builder.urdf(),
            links=LinkFrames(builder.cell),
        )
        self.heard: dict[str, list[Any]] = {JOINTS: [], TF: [], CLOCK: []}

    def join(self) -> None:
        """Subscribe, and wait until the node knows it."""
        heard = [
            self._late.listen(topic, lambda m, _, t=topic: self.heard[t].append(m), latched=False)
            for topic in (JOINTS, TF, CLOCK)
        ]
        assert self._late.wait(lambda: all(h.get_publisher_count() for h in heard), HANG_S)
        # Matched here is not yet matched there.
        assert self.station.wait(
            lambda: all(
                p.get_subscription_count() >= 1
                for p in (self.node._joints, self.node._clock, self.node._frames._moving)
            ),
            HANG_S,
        )

    def hear(self, until: Any) -> None:
        assert self._late.wait(until, HANG_S)

    def close(self) -> None:
        self._late.close()
        self.station.close()


@pytest.fixture
def resting(domain: int) -> Iterator[Resting]:
    resting = Resting(domain)
    yield resting
    resting.close()


def test_a_late_volatile_subscriber_hears_each_beat(resting: Resting) -> None:
    resting.node.beat()
    resting.join()
    stands = resting.robots.joints
    for beat in range(2, 5):
        resting.node.beat()
        resting.hear(lambda beat=beat: all(len(m) >= beat - 1 for m in resting.heard.values()))
        at_s = beat * BEAT_S
        for message in (resting.heard[JOINTS][-1], resting.heard[TF][-1].transforms[0]):
            assert Stamp.of(message.header.stamp).time_s == pytest.approx(at_s, abs=ROUNDING_S)
    resting.hear(lambda: Stamp.of(resting.heard[CLOCK][-1].clock).time_s >= 4 * BEAT_S - ROUNDING_S)
    assert len(resting.heard[JOINTS]) == len(resting.heard[TF]) == 3
    assert resting.heard[JOINTS][-1].position == pytest.approx(stands, abs=1e-6)


def test_a_node_that_follows_a_trajectory_does_not_rest(
    resting: Resting, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert resting.node._arms is not None
    busy = property(lambda server: moving[0])
    monkeypatch.setattr(type(resting.node._arms), "busy", busy)
    moving = [True]
    resting.node.beat()
    assert resting.robots.time_s == 0.0
    moving[0] = False
    resting.node.beat()
    assert resting.robots.time_s == pytest.approx(BEAT_S)


@pytest.mark.clock
def test_beats_come_at_twenty_hertz_of_wall_time(resting: Resting) -> None:
    """Missed beats are dropped, so a busy machine makes them slower, never faster."""
    beats: list[float] = []

    def beat() -> None:
        beats.append(time.monotonic())
        resting.node.beat()

    resting.station.every(BEAT_S, beat)
    resting.join()
    assert resting.station.wait(lambda: len(beats) > BEATS, HANG_S)
    mean_s = (beats[BEATS] - beats[0]) / BEATS
    assert 0.95 * BEAT_S < mean_s < 2 * BEAT_S
    resting.hear(lambda: len(resting.heard[JOINTS]) > BEATS // 2)
