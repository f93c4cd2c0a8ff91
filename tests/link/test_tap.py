"""A recorded scan over ROS 2: nothing is lost, and nothing changed."""

from __future__ import annotations

import filecmp
import shutil
from collections import Counter
from contextlib import closing
from pathlib import Path
from threading import Event
from types import SimpleNamespace

import numpy as np
import pytest
from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosbags.highlevel import AnyReader
from waiting import HANG_S

from twinct.link import RosRig, messages
from twinct.link.participant import Station
from twinct.link.recording import recorder_of
from twinct.link.senders import Members
from twinct.link.tap import Tap
from twinct.link.topics import CLOCK, ROBOTS, TOPICS
from twinct.robots.motion import MotionPlan
from twinct.runs import acquire_to_store, import_recordings
from twinct.scan import LocalRig, SimulationBuilder

pytestmark = [pytest.mark.ros, pytest.mark.process]

VIEWS, KILLED = 12, 5
"""Views of the scan, and the one before which its file is what a killed scan would leave."""


@pytest.fixture(scope="module")
def builder(scenario) -> SimulationBuilder:
    """With a plan that costs nothing: the tiny engines do not follow it."""
    targets = SimulationBuilder(scenario).targets
    moving = np.random.default_rng(3).normal(size=(VIEWS + 2, 3, 2))
    moving[[0, -1], 1:] = 0.0
    plan = MotionPlan(
        joint_names=("source_a", "detector_b"),
        time_s=np.arange(VIEWS + 2) / 8,
        state=moving,
        views=np.array([-1, *range(VIEWS), -1]),
        targets=tuple(targets),
        clearance_mm=np.full(VIEWS, 12.0),
        nearest=(("a", "b"),) * VIEWS,
    )
    return SimulationBuilder(scenario, plan)


def told_in(bag: Path) -> dict[str, list[tuple[bytes, str]]]:
    """By topic: the bytes of each message, and its fields."""
    found: dict[str, list[tuple[bytes, str]]] = {}
    with AnyReader([bag]) as reader:
        for connection, _, data in reader.messages():
            fields = repr(reader.deserialize(data, connection.msgtype))
            found.setdefault(connection.topic, []).append((bytes(data), fields))
    return found


class Independent:
    """A node that hears the bytes of all topics, and knows nothing of recorders."""

    def __init__(self, foreign, domain_id):
        self.node, self.heard = foreign(domain_id), {topic.name: [] for topic in TOPICS}
        latched = QoSProfile(depth=2000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        # Tiny engines have no description.
        self.spoken = [topic for topic in TOPICS if topic.name != "/robot_description"]
        for topic in self.spoken:
            keep = self.heard[topic.name].append
            self.node.node.create_subscription(
                topic.message_class, topic.name, keep, latched, raw=True
            )

    def meet(self):
        """Hear the first view, and so of every speaker: from then on nothing is missed."""
        self.node.until(lambda: all(self.heard[topic.name] for topic in self.spoken))

    @property
    def count(self):
        return sum(map(len, self.heard.values()))


class LookedAt:
    """A rig that copies the recording before it moves to a view; the one before is stored then."""

    def __init__(self, rig, bag, copy, ears):
        self._rig, self._bag, self._copy, self._ears = rig, bag, copy, ears
        self.expose, self.listen, self.close = rig.expose, rig.listen, rig.close

    def move(self, view, target):
        if view == 1:
            for ear in self._ears:
                ear.meet()
        if view == KILLED:
            shutil.copy(self._bag, self._copy)
        return self._rig.move(view, target)


def recorded(link, make_rig, builder, folder, ears):
    """A scan and its recording in a folder, and what a kill would have left of the recording."""
    recording = recorder_of(link, folder)
    rigs = recording.rigs(lambda *at: make_rig(recording.hear))

    def make(*at):
        return LookedAt(rigs(*at), folder / "scan.mcap", folder / "scan_1.mcap", ears)

    with closing(recording):
        store = acquire_to_store(builder, folder / "scan.zarr", make, resume=False)
        recording.finish(store.reported)
    assert recording.problems == []


def test_recordings_over_both_links(
    builder, fake_command, fakes, asked_once, foreign, tmp_path, monkeypatch
):
    # The tiny engines have joints of their own, which no room has.
    monkeypatch.setattr(SimulationBuilder, "urdf", lambda self: "")
    monkeypatch.setattr(SimulationBuilder, "cell", None)
    nowhere = SimpleNamespace(at=lambda joints: {"flange": (*joints[:3], 0.0, 0.0, 0.0, 1.0)})
    monkeypatch.setattr("twinct.robots.cell.LinkFrames", lambda cell: nowhere)
    ears = []

    def ros_rig(hear):
        plan = builder.plan
        rig = RosRig(builder.scenario, plan=plan, node_command=fake_command, hear=hear)
        ears.append(Independent(foreign, rig.domain_id))
        return rig

    def local(_):
        imager = fakes.FakeImager(builder.scenario.detector.panel)
        return LocalRig(fakes.FakeRobots(), imager, builder.scenario.detector.panel)

    folders = tmp_path / "ros2", tmp_path / "local"
    for folder, make_rig, listening in zip(folders, (ros_rig, local), (ears, ()), strict=True):
        folder.mkdir()
        recorded(folder.name, make_rig, builder, folder, listening)
    over_ros, at_home = (told_in(folder / "scan.mcap") for folder in folders)

    frames = over_ros.pop("/tf")
    ears[0].node.until(lambda: ears[0].count >= sum(map(len, over_ros.values())))
    published = {topic: Counter(data) for topic, data in ears[0].heard.items() if data}
    assert published == {topic: Counter(d for d, _ in told) for topic, told in over_ros.items()}
    assert len(over_ros["/xray/image"]) == VIEWS

    del over_ros["/diagnostics"], at_home["/robot_description"]
    over_ros["/tf"] = frames
    assert over_ros.keys() == at_home.keys()
    for topic, told in over_ros.items():
        assert [fields for _, fields in told] == [fields for _, fields in at_home[topic]], topic

    for folder in folders:
        again = tmp_path / f"{folder.name} again"
        assert import_recordings([folder / "scan.mcap"], again).missing == ()
        files = [p.relative_to(again) for p in (again / "scan.zarr").rglob("*") if p.is_file()]
        assert filecmp.cmpfiles(folder, again, files, shallow=False)[1:] == ([], [])
        killed = import_recordings([folder / "scan_1.mcap"], tmp_path / f"{folder.name} killed")
        assert killed.missing == tuple(range(KILLED, VIEWS))


def test_a_tap_that_comes_late_and_is_slow_hears_all(domain, tmp_path, monkeypatch):
    monkeypatch.setattr("twinct.link.tap.QUIET_S", 1e-6)
    members, gate, heard = Members(tmp_path), Event(), []

    def hear(message):
        """As slow as a disk that others use."""
        assert gate.wait(HANG_S)
        heard.append(message.number)

    with closing(Station(ROBOTS, domain)) as robots:
        members.enter(ROBOTS, robots.participant)
        out = robots.publisher(CLOCK)
        for tick in range(5):
            out.publish(messages.clock_message(float(tick)))
        tap = Tap(domain, members, hear, pytest.fail)
        assert robots.wait(out.get_subscription_count, HANG_S)
        assert out.wait_for_all_acked(Duration(seconds=HANG_S))
        tap._ending.set()  # as close does, which then waits
        gate.set()
        tap.close()
    assert heard == [1, 2, 3, 4, 5]
