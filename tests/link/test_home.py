"""Nodes that are driven: from target to target, and home."""

import os
import sys
from xml.etree import ElementTree as Xml

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseArray
from sensor_msgs.msg import JointState, TimeReference
from std_msgs.msg import String
from std_srvs.srv import Trigger

from twinct.geometry import Pose
from twinct.geometry.wire import PosePairs
from twinct.link.messages import diagnostic_values, executed_of, target_message
from twinct.link.processes import NodeProcess
from twinct.link.stamps import Stamp
from twinct.scan import SimulationBuilder

pytestmark = [pytest.mark.ros, pytest.mark.process]

AT_HOME_DEG = 0.02
"""Servos at rest are off by what they hold against gravity: 0.004 deg at most in 30 ways home."""


class Driver:
    """Somebody who knows the standard messages only."""

    def __init__(self, somebody) -> None:
        self.node = somebody
        self.out = somebody.publisher("/scan/target", PoseArray)
        self.reached = somebody.listen("/scan/reached", PoseArray)
        self.joints = somebody.listen("/joint_states", JointState)
        self.views = somebody.listen("/scan/views", TimeReference)
        self.diagnostics = somebody.listen("/diagnostics", DiagnosticArray)
        self.descriptions = somebody.listen("/robot_description", String)
        self.service = somebody.node.create_client(Trigger, "/scan/home")

    def wait(self) -> None:
        self.node.until(
            lambda: self.out.get_subscription_count() and self.service.service_is_ready()
        )

    def home(self) -> tuple[Trigger.Response, JointState]:
        """What the service answers, and the joints it speaks of."""
        answer = self.node.call(self.service, Trigger.Request())
        told = []

        def heard() -> bool:
            told[:] = [m for m in self.joints if f"time {_time_s(m):.3f} s" in answer.message]
            return bool(told)

        assert answer.success, answer.message
        self.node.until(heard, "the joints at home")
        return answer, told[-1]

    def refusals(self) -> list[dict[str, str]]:
        return [
            {"text": s.message, **diagnostic_values(s.values)}
            for message in self.diagnostics
            for s in message.status
            if s.level == s.ERROR
        ]


def _time_s(message: JointState) -> float:
    return Stamp.of(message.header.stamp).time_s


@pytest.fixture
def driven(tmp_path, foreign, domain, monkeypatch):
    """Starts a standalone robots node, and gives who drives it."""
    monkeypatch.setenv("MUJOCO_GL", "egl")
    started = []

    def start(command, scenario):
        file = tmp_path / "scenario.json"
        file.write_text(scenario.resolved())
        started.append(
            NodeProcess(
                "robots",
                [*command, "robots", str(file)],
                tmp_path / "robots.log",
                environment=os.environ,
                on_end=lambda _: None,
            )
        )
        driver = Driver(foreign(domain))
        driver.wait()
        return driver

    yield start
    for process in started:
        process.stop()


def test_a_driven_node_goes_where_it_can_and_home_again(driven, short):
    targets = SimulationBuilder(short).targets
    node = driven((sys.executable, "-m", "twinct", "node"), short)
    fresh, at_home = node.home()
    assert "clearance" in fresh.message
    told = len(node.joints)
    node.node.until(lambda: len(node.joints) > told + 5, "joints at rest")
    home, at_home_s = np.array(at_home.position), _time_s(at_home)
    assert at_home_s > 0
    node.node.until(lambda: node.descriptions, "the robot description")
    [description] = node.descriptions
    joints = [e.get("name") for e in Xml.fromstring(description.data)]
    assert set(at_home.name) <= set(joints)

    # Sent while the arms move on to the first, the others have their turn after it.
    source, detector = targets[0][0]
    away = Pose(source.position + [0, -1500, 0], source.quat)
    asked = [targets[3], PosePairs.at(away, detector), targets[0]]
    for second, target in enumerate(asked):
        node.out.publish(target_message(Stamp(5, second), target))
    both = node.reached, node.views  # of two topics either may be heard first
    node.node.until(lambda: all(len(m) >= 2 for m in both) and node.refusals())
    assert [Stamp.of(m.time_ref) for m in node.views] == [Stamp(5, 0), Stamp(5, 2)]
    taken = [Stamp.of(m.header.stamp) for m in node.reached]
    assert taken == [Stamp.of(m.header.stamp) for m in node.views]
    assert at_home_s < taken[0].time_s < taken[1].time_s
    for message, target in zip(node.reached, asked[::2], strict=True):
        for there, wanted in zip(executed_of(message)[0], target[0], strict=True):
            assert there.distance_mm(wanted) < 1
    [refusal] = node.refusals()
    assert refusal["stamp"] == "5.000000001" and refusal["arm"] == "source"
    assert refusal["reason"].startswith("source arm: out of reach by ")

    def there():
        return [m for m in node.joints if Stamp.of(m.header.stamp) == taken[1]]

    node.node.until(there, "the joints at the last target")
    assert np.abs(np.array(there()[0].position) - home).max() > 0.1
    _, again = node.home()
    assert np.degrees(np.abs(np.array(again.position) - home).max()) < AT_HOME_DEG
    assert np.abs(again.velocity).max() < 1e-3

    # Poses that were told of a way home would be heard before those of a target that is repeated.
    node.node.ask(
        lambda: node.out.publish(target_message(Stamp(5, 0), asked[0])),
        lambda: len(node.reached) > 2,
    )
    poses = [Stamp.of(m.header.stamp) for m in node.reached]
    assert poses[:3] == [*taken, taken[0]], "an image would be taken at home"
