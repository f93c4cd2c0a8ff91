"""A ROS 2 node that attacks a scan; ``attack_graph.py`` starts it in a process of its own."""

import os
import random
import select
import time
from typing import Any

import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import Trigger

from twinct.geometry.wire import PosePairs, Reached
from twinct.link import messages
from twinct.link.stamps import Epoch, Stamp
from twinct.link.topics import (
    CLOCK,
    COMMANDED,
    DIAGNOSTICS,
    IMAGE,
    JOINTS,
    PLAN,
    PLAN_VIEWS,
    REACHED,
    STATE,
    TARGET,
    TOPICS,
    VIEWS,
)
from twinct.scenario import parse_scenario

FOUND_S = 60.0
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
ANSWERS = (VIEWS, REACHED, JOINTS, STATE, IMAGE)
OWN_NAMES = ("twinct_robots", "twinct_xray", "twinct_scan", "twinct_scan_tap")


class Attacker:
    """A node that knows the scan but does not belong to it."""

    def __init__(self, told):
        self.told, self.rng = told, random.Random(told["seed"])
        self.scenario = parse_scenario(told["scenario"])
        self.epoch = Epoch.parse(told["epoch"])
        self.targets = [messages.target_of(self.poses(p)) for p in told["targets"]]
        self.context = Context()
        rclpy.init(
            context=self.context,
            domain_id=told["domain"],
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self.node = rclpy.create_node(told["name"], context=self.context)
        self.second = None
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.publishers = {}
        self.step = self.view = 0

    @staticmethod
    def poses(numbers):
        """Return the two poses of a target as a message."""
        return messages.target_message(Stamp(0, 0), PosePairs.from_sevens([numbers]))

    def say(self, topic, message):
        """Publish a message on a topic."""
        key = topic.name, topic.message_class
        if key not in self.publishers:
            self.publishers[key] = self.node.create_publisher(
                topic.message_class, topic.name, LATCHED
            )
        self.publishers[key].publish(message)

    def stamps(self):
        """Return the answer stamp and the number of a view: the three attacked views in turn."""
        view = min(self.view + self.step % 3, len(self.targets) - 1)
        return Stamp.at(self.told["taken_s"][view]), view

    def answer(self, shape=None, value=None, numbers=4):
        """Publish wrong messages on all topics that answer a target."""
        stamp, view = self.stamps()
        rows, columns = shape or self.scenario.detector.panel.shape
        filled = self.rng.random() if value is None else value
        target = self.targets[view]
        bad = Reached(
            executed=PosePairs(target.detector, target.source, target.source),
            joint_names=tuple(f"j{i}" for i in range(numbers)),
            position=np.full(numbers, filled),
            velocity=np.full(numbers, filled),
            effort=np.full(numbers, filled),
            state=np.full(6, filled),
            time_s=77.0,
            clearance_mm=filled,
            since_middle_s=0.0,
        )
        self.say(VIEWS, messages.view_message(Stamp(99, 0), self.epoch.at(view), view))
        poses = messages.reached_message(stamp, messages.executed(bad))
        if value is not None and np.isnan(value):
            list(poses.poses)[0].position.x = value
        self.say(REACHED, poses)
        self.say(JOINTS, messages.joints_message(stamp, bad))
        self.say(STATE, messages.state_message(stamp, bad))
        self.say(IMAGE, messages.image_message(stamp, np.full((rows, columns), filled, np.float32)))

    def target(self, view, *, moved=0.0):
        """Publish a target of the scan, shifted along x by ``moved``, m."""
        target = self.targets[view]
        ((x, *rest), detector) = target.sevens[0]
        other = PosePairs.from_sevens([((x + moved, *rest), detector)])
        self.say(TARGET, messages.target_message(self.epoch.at(view), other))

    def forged(self):
        """Publish complete answers with wrong numbers."""
        self.answer()

    def shapes(self):
        """Publish answers of wrong sizes."""
        rows, columns = self.scenario.detector.panel.shape
        one = self.rng.choice(
            [(1, 1), (1, columns), (rows, 1), (columns, rows), (0, 0), (500, 500)]
        )
        self.answer(shape=one, numbers=self.rng.choice([0, 1, 4, 12, 1000]))

    def nans(self):
        """Publish answers with numbers that are not finite."""
        self.answer(value=self.rng.choice([np.nan, np.inf, -np.inf]))

    def empty(self):
        """Publish an empty message on every topic."""
        for topic in TOPICS:
            self.say(topic, topic.message_class())

    def types(self):
        """Publish messages of another type on every topic."""
        if self.second is None:  # a participant cannot have two types on one topic
            context = Context()
            rclpy.init(
                context=context,
                domain_id=self.told["domain"],
                signal_handler_options=SignalHandlerOptions.NO,
            )
            node = rclpy.create_node("other_types", context=context)
            kinds = {t.name: Image if t.message_class is String else String for t in TOPICS}
            self.second = [
                (node.create_publisher(kind, name, LATCHED), kind) for name, kind in kinds.items()
            ]
        for publisher, kind in self.second:
            publisher.publish(kind())

    def lies(self):
        """Publish messages that misstate their sizes."""
        stamp, _ = self.stamps()
        image = messages.image_message(stamp, np.ones(self.scenario.detector.panel.shape, "f4"))
        what = self.rng.randrange(4)
        if what == 0:
            image.height, image.width = 2**32 - 1, 2**32 - 1
        elif what == 1:
            image.step = 0
        elif what == 2:
            image.encoding = "rgb8" * 1000
        else:
            image.data = image.data[:7]
        self.say(IMAGE, image)
        message = Float64MultiArray(data=[1.0])
        message.layout.data_offset = 2**32 - 1
        self.say(STATE, message)
        self.say(JOINTS, JointState(name=["a"] * 5000, position=[float("nan")]))

    def flood(self):
        """Publish hundreds of messages at once on one topic."""
        topic = self.rng.choice((*ANSWERS, TARGET, DIAGNOSTICS))
        for _ in range(300):
            self.say(topic, topic.message_class())

    def flood_plan(self):
        """Publish dozens of messages at once on each topic of the plan."""
        for topic in (PLAN, PLAN_VIEWS, COMMANDED):
            for _ in range(30):
                self.say(topic, topic.message_class())

    def big(self):
        """Publish an image of 9 MB."""
        self.say(IMAGE, messages.image_message(self.stamps()[0], np.ones((1500, 1500), "f4")))

    def repeated(self):
        """Publish targets a second time."""
        self.target(self.stamps()[1])

    def early(self):
        """Publish targets before their turn."""
        self.target(min(len(self.targets) - 1, self.view + 1 + self.step % 9))

    def late(self):
        """Publish the first target again."""
        self.target(0)

    def changed(self):
        """Publish targets with correct stamps and wrong poses."""
        self.target(self.stamps()[1], moved=self.rng.choice([1e-9, 0.1, 1e300]))

    def foreign_target(self):
        """Publish targets that belong to no view, some of them malformed."""
        message = self.poses(self.told["targets"][0])
        message.header.stamp.sec = self.rng.randrange(2**31)
        if self.rng.random() < 0.5:
            list(message.poses)[0].orientation.w = float("nan")
        if self.rng.random() < 0.3:
            message.poses = list(message.poses) * 1000
        self.say(TARGET, message)

    def refusals(self):
        """Publish refusals and readiness under the names of the nodes."""
        _, view = self.stamps()
        for name in OWN_NAMES[:2]:
            for level in (messages.ERROR, messages.OK):
                values = {"target": "all", "asked_by": "all", "reason": "no"}
                self.say(
                    DIAGNOSTICS,
                    messages.diagnostic_message(self.epoch.at(view), name, level, "no", values),
                )

    def plans(self):
        """Publish empty plans with the correct stamp."""
        stamp = self.epoch.at(0)
        for topic in (PLAN, PLAN_VIEWS, COMMANDED):
            message = topic.message_class()
            message.header.stamp.sec, message.header.stamp.nanosec = stamp
            self.say(topic, message)

    def clocks(self):
        """Publish wrong times."""
        for time_s in (0.0, 1e9, self.rng.random() * 100):
            self.say(CLOCK, messages.clock_message(time_s))

    def homes(self):
        """Call the service, and offer a second server for it."""
        if not hasattr(self, "client"):
            self.client = self.node.create_client(Trigger, "/scan/home")
            self.node.create_service(Trigger, "/scan/home", lambda _, answer: answer)
        self.client.call_async(Trigger.Request())

    def deaf(self):
        """Subscribe reliably to all topics without taking messages."""
        if not hasattr(self, "deaf_readers"):
            self.deaf_readers = True
            for topic in TOPICS:
                kind = topic.message_class
                self.node.create_subscription(kind, topic.name, lambda _: None, LATCHED)
        time.sleep(0.5)

    def own_name(self):
        """Publish answers and refusals."""
        self.answer()
        self.refusals()

    def run(self):
        """Run the attack that a line of stdin names until the next line; report its start."""
        for topic in TOPICS:
            self.publishers[topic.name, topic.message_class] = self.node.create_publisher(
                topic.message_class, topic.name, LATCHED
            )
        deadline = time.monotonic() + FOUND_S
        while time.monotonic() < deadline and not self.found():
            self.executor.spin_once(timeout_sec=0.1)
        print("here", flush=True)
        act: Any = None
        while True:
            ready, _, _ = select.select([0], [], [], 0 if act else None)
            if ready:
                line = os.read(0, 1000).decode().strip()
                if not line:
                    return
                act, self.view = getattr(self, KINDS[line.split(":")[0]]), int(line.split(":")[1])
                act()
                print("begun", flush=True)
            act()
            self.step += 1
            self.executor.spin_once(timeout_sec=0.02)

    def found(self):
        """Return True if the scan subscribes to all topics that answer a target."""
        keys = [(topic.name, topic.message_class) for topic in ANSWERS]
        return all(self.publishers[key].get_subscription_count() for key in keys)


KINDS = {
    **{"forged answers": "forged", "wrong shapes": "shapes", "not finite": "nans"},
    **{"empty messages": "empty", "other types": "types", "lies about sizes": "lies"},
    **{"flood": "flood", "flood of plans": "flood_plan", "large images": "big"},
    **{"repeated targets": "repeated", "early targets": "early", "late targets": "late"},
    **{"changed targets": "changed", "foreign targets": "foreign_target"},
    **{"forged refusals": "refusals", "forged plans": "plans", "forged clock": "clocks"},
    **{"service": "homes", "deaf readers": "deaf", "answers and refusals": "own_name"},
}
