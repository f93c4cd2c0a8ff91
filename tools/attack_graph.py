"""Attack running scans from a foreign ROS 2 node; no wrong data may reach the store.

python tools/attack_graph.py --attacks 200 --seed 1
python tools/attack_graph.py --attacks 12 --engines real

The scans run over ROS 2 with tiny engines (``--engines real``: MuJoCo and gVXR). The attacker is a
second process in the same domain that knows the stamps of all targets and answers in advance. It
attacks in twenty ways for three views each, in random order: forged answers, wrong shapes, NaN,
other types on the same topics, floods, repeated, early, late and changed targets, forged plans,
clocks and refusals, service calls, and readers that take no messages. In every second scan it bears
the name of one of the scan's own nodes. The store must equal an undisturbed store in files and
bytes, or the scan must end with a message that names the stranger. A stranger that answers must be
named once per topic. The exit code is 1 otherwise.
"""

import argparse
import json
import logging
import os
import random
import select
import subprocess
import sys
import tempfile
import time
from pathlib import Path
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
from store_damages import contents

from twinct.core.errors import TwinctError
from twinct.geometry.wire import Instant, Reached, Target
from twinct.link import Domain, RosRig, messages
from twinct.link.rig import NODE_COMMAND
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
from twinct.runs import acquire_to_store
from twinct.scan import SimulationBuilder
from twinct.scenario import load_scenario, parse_scenario

ROOT = Path(__file__).parents[1]
KEYS = [
    *("detector.columns=32", "detector.rows=24", "detector.pixel_pitch_mm=10"),
    "specimen.parts=[{name: ball, shape: {kind: sphere, radius_mm: 60}, material: bone}]",
]
FAKE_COMMAND = (sys.executable, str(ROOT / "tests" / "ros" / "fake_node.py"))
ANSWER_S = 120.0
FOUND_S = 60.0
VIEWS_AN_ATTACK = 3
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
        return messages.target_message(Stamp(0, 0), Target(*map(tuple, numbers)))

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
            executed=Instant(target.detector_m, target.source_m, target.source_m),
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
        x, *rest = target.source_m
        other = Target((x + moved, *rest), target.detector_m)
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


class Log(logging.Handler):
    """Collect the log messages about strangers."""

    def __init__(self):
        super().__init__()
        self.lines = []

    def emit(self, record):
        """See ``logging.Handler``."""
        if "not part of this scan" in record.getMessage():
            self.lines.append(record.getMessage())


def scan(scenario, path, command, domain=None, before=None):
    """Run a scan into a store; call ``before(view)`` before each view is requested."""

    def rigs(builder, first, state):
        rig = RosRig(
            scenario,
            plan=builder.plan if command == NODE_COMMAND else None,
            first_view=first,
            start_state=state,
            node_command=command,
            answer_s=ANSWER_S,
            domain=domain,
        )
        move = rig.move

        def attacked(view, target):
            if before is not None:
                before(view)
            return move(view, target)

        rig.move = attacked if before else move
        return rig

    return acquire_to_store(SimulationBuilder(scenario), path, rigs, resume=False)


class Attacked:
    """A scan under attack.

    Attributes:
        ended: outcome of the scan, such as "equal".
        faults: descriptions of all faults.
        done: first attacked view of each attack that began.
    """

    def __init__(self, name, seed, kinds, every, scenario, folder, command, store):
        self.domain, self.log, self.done, self.faults = Domain(), Log(), {}, []
        self.kinds, self.every = list(kinds), every
        taken_s = store.readings(0, store.views).simulated_s - 1 / 300
        self.told = {
            "name": name,
            "seed": seed,
            "domain": self.domain.id,
            "scenario": json.loads(scenario.resolved()),
            "epoch": str(Epoch.of(scenario)),
            "targets": [(t.source_m, t.detector_m) for t in SimulationBuilder(scenario).targets],
            "taken_s": taken_s.tolist(),
        }
        self.stranger = None
        logger = logging.getLogger("twinct")
        logger.addHandler(self.log)
        path = folder / "scan.zarr"
        try:
            scan(scenario, path, command, self.domain, self.before)
            self.ended = "equal"
        except TwinctError as error:
            self.ended = "ended, named" if "not part of this scan" in str(error) else "ended"
            if self.ended == "ended":
                self.faults.append(f"ended without the stranger's name: {error}")
        except Exception as error:
            self.ended = "crashed"
            self.faults.append(repr(error))
        finally:
            logger.removeHandler(self.log)
            if self.stranger is not None:
                if self.stranger.poll() is not None:
                    self.faults.append(f"the attacker ended with {self.stranger.returncode}")
                self.stranger.kill()
                self.stranger.communicate()
        self.judge(path, store.path)

    def before(self, view):
        """Start the next attack if it is due."""
        if view % self.every or view // self.every >= len(self.kinds):
            return
        if self.stranger is None:
            self.stranger = subprocess.Popen(
                [sys.executable, __file__, "--attacker", json.dumps(self.told)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
            self.heard("here")
        kind = self.kinds[view // self.every]
        self.done[kind] = view
        assert self.stranger.stdin is not None
        self.stranger.stdin.write(f"{kind}:{view}\n")
        self.stranger.stdin.flush()
        self.heard("begun")

    def heard(self, word):
        """Raise RuntimeError unless the attacker's next line equals a word."""
        assert self.stranger is not None and self.stranger.stdout is not None
        line = self.stranger.stdout.readline().strip()
        if line != word:
            raise RuntimeError(f"the attacker said {line!r}")

    def judge(self, path, whole):
        """Compare the store and the log with those of an undisturbed scan."""
        expected, found = contents(whole), contents(path) if path.exists() else {}
        if self.ended == "equal" and found != expected:
            names = [n for n in expected.keys() | found.keys() if expected.get(n) != found.get(n)]
            self.faults.append(f"the store differs: {sorted(names)[:5]}")
        chunks = {n: data for n, data in found.items() if "/c." in n}
        if wrong := [n for n, data in chunks.items() if expected.get(n) != data]:
            self.faults.append(f"wrong data stored: {wrong[:5]}")
        lines = self.log.lines
        if len(lines) != len(set(lines)):
            self.faults.append("named more than once")
        if "forged answers" in self.done:
            for topic in ANSWERS:
                if not any(f"on {topic.name}:" in line for line in lines):
                    self.faults.append(f"the sender on {topic.name} was not named")


def main():
    """Run the attacks and print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--attacks", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--engines", choices=("tiny", "real"), default="tiny")
    parser.add_argument("--attacker", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.attacker:
        Attacker(json.loads(options.attacker)).run()
        return 0
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    real = options.engines == "real"
    command = NODE_COMMAND if real else FAKE_COMMAND
    views = VIEWS_AN_ATTACK * len(options.kinds) + 2
    keys = [*KEYS, f"trajectory.views={views}"]
    scenario = load_scenario(ROOT / "scenarios" / "demo.yaml", keys)
    bad, total, number = 0, 0, 0
    with tempfile.TemporaryDirectory() as folder:
        store = scan(scenario, Path(folder) / "whole.zarr", command)
        print("scan  stranger's name   attacks  ended         named on  faults")
        while total < options.attacks:  # a scan that ends early omits some attacks
            rng = random.Random(f"{options.seed} {number}")
            kinds = rng.sample(options.kinds, len(options.kinds))[: options.attacks - total]
            name = rng.choice(OWN_NAMES) if number % 2 else "stranger"
            with tempfile.TemporaryDirectory(dir=folder) as place:
                told = f"{options.seed} {number}", kinds, VIEWS_AN_ATTACK, scenario, Path(place)
                attacked = Attacked(name, *told, command, store)
            total += len(attacked.done)
            if not attacked.done:
                raise SystemExit(f"no attack began: {attacked.faults}")
            bad += bool(attacked.faults)
            topics = f"{len(attacked.log.lines)} topics"
            faults = "; ".join(attacked.faults) or "none"
            done = len(attacked.done)
            print(
                f"{number:4}  {name:16}  {done:7}  {attacked.ended:12}  {topics:8}  {faults}",
                flush=True,
            )
            for line in attacked.log.lines if attacked.faults else ():
                print(line, file=sys.stderr)
            if attacked.faults:
                print(f"attacks and first views: {attacked.done}", file=sys.stderr)
            number += 1
    print(f"{total} attacks of {len(options.kinds)} kinds")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
