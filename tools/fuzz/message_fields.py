"""Fuzzing of messages: changed fields or bytes are decoded, answered by nodes and imported."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from cases import Case
from mcap.reader import make_reader
from message_graph import (
    MEMBERS,
    STRANGER,
    FakeImager,
    Station,
    decoded,
    members_in,
    require_finite,
)
from mutations import NASTY_TEXTS, broken
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.serialization import deserialize_message, serialize_message
from store_files import everything
from valid_scans import SCANS, make_scans

from twinct import load_scan
from twinct.core.errors import InputError, TwinctError
from twinct.geometry.wire import PosePairs, Reached
from twinct.link import messages
from twinct.link.joint_trajectory import PARTS, PlanListener
from twinct.link.messages import MalformedError
from twinct.link.node import Diagnostics
from twinct.link.recording.bag import Bag
from twinct.link.rig import RosRig
from twinct.link.robots_node import RobotsNode, Turns
from twinct.link.stamps import Epoch, Stamp
from twinct.link.topics import (
    DIAGNOSTICS,
    IMAGE,
    JOINTS,
    REACHED,
    ROBOTS,
    SCAN,
    STATE,
    TARGET,
    TOPICS,
    VIEWS,
    XRAY,
    Topic,
)
from twinct.link.xray_node import XRayNode
from twinct.robots.motion import MotionPlan
from twinct.runs import import_scan
from twinct.scan import ScanStore, SimulationBuilder
from twinct.scenario import stage_digests

KINDS = {topic.name: topic for topic in TOPICS}
ANSWERS = (VIEWS, REACHED, JOINTS, STATE, IMAGE)
NUMBERS = (np.nan, np.inf, -np.inf, 1e308, -1e308, 5e-324, 1e39, -1.0, 0.0, -0.0, 1.0, 2.0, 1e-9)
WHOLE = {
    "int32": (0, 1, -1, 2, 2**31 - 1, -(2**31), 10**9),
    "uint32": (0, 1, 2, 255, 2**31, 2**32 - 1, 10**9, 999_999_999),
    "uint8": (0, 1, 2, 255),
}
"""Integers by type, within its range; beyond it, the state of the encoder is undefined."""
TEXTS = (
    *("", "world", "map", "wörld", "世界", "a\0b", "x" * 70_000, "32FC1", "64FC1", "mono8"),
    *("view 1", "view -1", "view 99999999999999999999", "view \u0661", "view 2 ", "1.5", "nan"),
    *("0.000000000", "1.000000001", "-1.000000000", "9" * 20 + ".000000000"),
    *("\u0661." + 9 * "\u0660", "1." + 9 * "\u00b2"),  # digits in the sense of str.isdigit
    *NASTY_TEXTS,
)


class Kind:
    """One or several faulty messages, given to one of their receivers."""

    seconds = 30.0
    memory_bytes = 2 * 2**30

    def __init__(self, material: Path) -> None:
        """Make the scans whose messages are changed, unless an earlier worker has made them."""
        make_scans(material)
        self._recorded = {name: _Recorded(material / name) for name in SCANS}

    def case(self, rng: random.Random, folder: Path) -> Case:
        """Make a case with one faulty message, or a faulty recording, for a random receiver."""
        of = self._recorded[rng.choice(list(SCANS))]
        make = rng.choice((_decoded, _of_rig, _of_rig, _of_robots, _of_xray, _of_plan, _of_bag))
        told, act = make(rng, folder, of)
        return Case(f"{make.__name__[1:]}: {told}", act)


class _Recorded:
    """All messages of a scan as bytes, in order."""

    def __init__(self, path: Path) -> None:
        self.store = ScanStore(path / "scan.zarr")
        self.scenario, self.plan = self.store.scenario, self.store.plan
        self.arms = bool(self.store.joint_names)
        self.epoch = Epoch.of(stage_digests(self.scenario)["images"])
        self.targets = self.store.commanded.targets()
        self.robots = None if self.arms else SimulationBuilder(self.scenario)
        self.file = path / "scan.mcap"
        with self.file.open("rb") as file:
            reader = make_reader(file)
            found = list(reader.iter_messages())
            self.attached = [(a.name, a.data) for a in reader.iter_attachments()]
            self.notes = [(m.name, m.metadata) for m in reader.iter_metadata()]
        self.said = [(c.topic, s.name, m.data, m.log_time) for s, c, m in found if s is not None]
        self.whole = everything(load_scan(path))

    def of(self, topic: Topic) -> list[bytes]:
        """Return all messages of a topic."""
        return [data for name, _, data, _ in self.said if name == topic.name]

    def answers(self, view: int) -> dict[Topic, bytes]:
        """Return the messages that answered the target of a view, by topic."""
        told = deserialize_message(self.of(VIEWS)[view], VIEWS.message_class)
        stamp = Stamp.of(told.header.stamp)
        return {
            topic: next(data for data in self.of(topic) if _stamp(decoded(topic, data)) == stamp)
            for topic in ANSWERS
        }


def _stamp(message: Any) -> Stamp | None:
    if hasattr(message, "layout"):
        return messages.state_stamp(message)
    return Stamp.of(message.header.stamp)


def _changed(rng: random.Random, topic: Topic, data: bytes) -> tuple[bytes, str]:
    """Return a changed message as bytes, and a description of the change."""
    if rng.random() < 0.25:
        new, told = broken(rng, data)
        return new, f"{topic.name}: {told}"
    message, told = decoded(topic, data), ""
    for _ in range(rng.choice((1, 1, 2, 3))):
        told = f"{told} {_other_field(rng, message)}"
    return serialize_message(message), f"{topic.name}:{told}"


def _other_field(rng: random.Random, message: Any) -> str:
    """Change one field of a message within its type, and return a description."""
    name, kind = rng.choice(list(message.get_fields_and_field_types().items()))
    value = getattr(message, name)
    if hasattr(value, "get_fields_and_field_types"):
        return f"{name}.{_other_field(rng, value)}"
    if kind.startswith("sequence"):
        return f"{name} {_other_list(rng, message, name, value)}"
    new: Any
    if kind == "string":
        new = rng.choice(TEXTS)
    elif kind == "double":
        new = rng.choice(NUMBERS)
    elif kind in ("double[9]", "double[12]"):
        new = np.array(value)
        new[rng.randrange(len(new))] = rng.choice(NUMBERS)
    elif kind == "octet":
        new = bytes([rng.choice((0, 1, 2, 3, 255))])
    elif kind == "boolean":
        new = rng.random() < 0.5
    else:
        new = rng.choice(WHOLE[kind])
    setattr(message, name, new)
    return f"{name} = {str(new)[:30]!r}"


def _other_list(rng: random.Random, message: Any, name: str, value: Any) -> str:
    items = list(value)
    inner = [item for item in items if hasattr(item, "get_fields_and_field_types")]
    pick = rng.random()
    if inner and pick < 0.5:
        place = rng.randrange(len(inner))
        return f"[{place}].{_other_field(rng, inner[place])}"
    if pick < 0.7 and items and not inner:
        place = rng.randrange(len(items))
        choices = TEXTS if isinstance(items[0], str) else NUMBERS
        new = rng.randrange(256) if isinstance(items[0], int) else rng.choice(choices)
        items[place] = new
        setattr(message, name, items)
        return f"[{place}] = {str(new)[:30]!r}"
    size = rng.choice((0, 1, max(len(items) - 1, 0), len(items) + 1, 2 * len(items), 3000))
    items = (items * (size // max(len(items), 1) + 1))[:size]
    setattr(message, name, items)
    return f"of {len(items)}"


def _check_reached(reached: Reached, *, arms: bool) -> None:
    for poses in (reached.executed, reached.path, reached.before or PosePairs()):
        require_finite(np.array(poses.sevens))
    require_finite(
        reached.position, reached.velocity, reached.effort, reached.state, reached.time_s
    )
    if arms:
        require_finite(reached.clearance_mm)
    if len({len(reached.joint_names), *(map(len, (reached.position, reached.velocity)))}) != 1:
        raise AssertionError("joints of several numbers")


def _decoded(rng: random.Random, folder: Path, of: _Recorded) -> tuple[str, Callable[[], str]]:
    """Make a case in which the reader of a topic decodes a changed message."""
    del folder
    arms, panel = of.arms, of.scenario.detector.panel

    def state(message: Any) -> None:
        messages.state_stamp(message)
        require_finite(messages.checked_state(message, arms=True).data)

    def target(message: Any) -> None:
        found = messages.target_of(message)
        require_finite(*(pose.matrix for pose in found[0]))

    def executed(message: Any) -> None:
        found = messages.executed_of(message)
        messages.parts_of(found, rng.choice((1, 2, 5)))
        require_finite(*(pose.matrix for pose in found.object))

    def joints(message: Any) -> None:
        found = messages.joints_of(messages.checked_joints(message, arms=arms))
        require_finite(found.position, found.velocity, found.effort, found.time_s)

    reads: dict[Topic, Callable[[Any], object]] = {
        **{TARGET: target, REACHED: executed, JOINTS: joints, STATE: state},
        IMAGE: lambda m: require_finite(messages.image_of(m, rng.choice((panel.shape, None)))),
        VIEWS: lambda m: of.epoch.view(Stamp.of(m.time_ref)),
    }
    topic = rng.choice(list(reads))
    data, told = _changed(rng, topic, rng.choice(of.of(topic)))

    def act() -> str:
        try:
            reads[topic](decoded(topic, data))
        except (MalformedError, rclpy_implementation.RMWError):
            return "refused"
        return "read"

    return told, act


def _of_rig(rng: random.Random, folder: Path, of: _Recorded) -> tuple[str, Callable[[], str]]:
    """Make a case in which one of its nodes, or a stranger, sends the rig a changed message."""
    view = rng.randrange(len(of.targets))
    good, topic = of.answers(view), rng.choice((*ANSWERS, DIAGNOSTICS))
    if topic == DIAGNOSTICS:
        status = messages.diagnostic_message(
            of.epoch.at(view), XRAY, messages.ERROR, "no", {"reason": "x"}
        )
        data, told = _changed(rng, topic, serialize_message(status))
    else:
        data, told = _changed(rng, topic, good[topic])
    stranger = rng.random() < 0.4
    owner = topic.owner or rng.choice((ROBOTS, XRAY))
    said = [(t, d, MEMBERS[t.owner]) for t, d in good.items() if stranger or t != topic]
    rng.shuffle(said)
    changed = (topic, data, STRANGER if stranger else MEMBERS[owner])
    said.insert(rng.randrange(len(said) + 1), changed)

    def rig() -> RosRig:
        rig, station = object.__new__(RosRig), Station()
        rig.epoch, rig.domain_id = of.epoch, 0
        members = members_in(folder)
        own: dict[str, Any] = {
            **{"_answer_s": 0.0, "_samples": of.scenario.source.motion_samples, "_nodes": []},
            **{"_shape": of.scenario.detector.panel.shape, "_taken": {}, "_got": {}},
            **{"_joints_until": Stamp(0, 0), "_asked": None, "_ready": {ROBOTS, XRAY}},
            **{"_refusal": None, "_conflict": None, "_ended": [], "_closing": False},
            **{"_tell_joints": lambda joints: require_finite(joints.position, joints.time_s)},
            **{"_station": station, "_members": members, "_me": MEMBERS[SCAN] * 12},
            "_diagnostics": Diagnostics(station, lambda _: None),  # type: ignore[arg-type]
        }
        for name, value in own.items():
            setattr(rig, name, value)
        rig._open(station, arms=of.arms)  # type: ignore[arg-type]
        station.queue = said
        return rig

    def act() -> str:
        opened = rig()
        try:
            reached = opened.move(view, of.targets[view])
            image = opened.expose(view)
        except TwinctError:
            if stranger:
                raise AssertionError("a stranger ended the scan") from None
            return "refused"
        _check_reached(reached, arms=of.arms)
        require_finite(image)
        stored = of.store.transmission(view), of.store.state(view)
        same = [np.array_equal(a, b) for a, b in zip((image, reached.state), stored, strict=True)]
        if stranger and not all(same):
            raise AssertionError("a stranger's answer was accepted")
        return "unchanged" if all(same) else "answered"

    return f"{'stranger' if stranger else owner}: {told}", act


def _of_robots(rng: random.Random, folder: Path, of: _Recorded) -> tuple[str, Callable[[], str]]:
    """Make a case in which the robots node, alone or in a scan, gets a changed target."""
    builder, own = of.robots, rng.random() < 0.5
    if builder is None:
        return _decoded(rng, folder, of)
    view = rng.randrange(len(of.targets)) if not own else 0
    good = serialize_message(messages.target_message(of.epoch.at(view), of.targets[view]))
    data, told = _changed(rng, TARGET, good)

    def act() -> str:
        station: Any = Station()
        turns = Turns(of.epoch, of.targets, 0) if own else None
        said = Diagnostics(station, lambda _: None)
        members = members_in(folder) if own else None
        RobotsNode(station, said, builder.robots(), turns, members)
        station.hear(TARGET, data, MEMBERS[SCAN])
        reached = station.out[REACHED.name].sent
        if not reached:
            return _refused(station)
        answered, asked = messages.executed_of(reached[0]), decoded(TARGET, data)
        expected = [messages.numbers_of(pose) for pose in asked.poses]
        if [pose.seven for pose in answered[0]] != expected:
            raise AssertionError("it went to another pose")
        return "answered"

    return told, act


def _refused(station: Station) -> str:
    """Return "refused", or raise AssertionError unless a diagnostic message was sent."""
    if not station.told:
        raise AssertionError("dropped without a diagnostic")
    return "refused"


def _of_xray(rng: random.Random, folder: Path, of: _Recorded) -> tuple[str, Callable[[], str]]:
    """Make a case in which the X-ray node, alone or in a scan, gets changed messages of a view."""
    good, own, topic = of.answers(0), rng.random() < 0.5, rng.choice((REACHED, REACHED, VIEWS))
    if not own:
        topic = REACHED
    data, told = _changed(rng, topic, good[topic])
    panel, samples = of.scenario.detector.panel, of.scenario.source.motion_samples
    sender = STRANGER if rng.random() < 0.2 else MEMBERS[ROBOTS]

    def act() -> str:
        station: Any = Station()
        said = Diagnostics(station, lambda _: None)
        scan = (of.epoch, members_in(folder)) if own else (None, None)
        XRayNode(station, said, FakeImager(panel), panel, *scan, samples)
        for name in (VIEWS, REACHED):
            changed = name == topic
            station.hear(name, data if changed else good[name], sender)
        images = station.out[IMAGE.name].sent
        if images:
            messages.image_of(images[0], panel.shape)
            return "answered"
        if own and _other_stamp(topic, data, good[topic]):
            return "waits"  # for the other message with its stamp
        return _refused(station)

    return told, act


def _other_stamp(topic: Topic, data: bytes, good: bytes) -> bool:
    try:
        return _stamp(decoded(topic, data)) != _stamp(decoded(topic, good))
    except rclpy_implementation.RMWError:
        return True


def _of_plan(rng: random.Random, folder: Path, of: _Recorded) -> tuple[str, Callable[[], str]]:
    """Make a case in which a node that waits for its plan gets a changed part."""
    if of.plan is None:
        return _decoded(rng, folder, of)
    plan, good = of.plan, {topic: of.of(topic)[0] for topic in PARTS}
    topic = rng.choice(PARTS)
    data, told = _changed(rng, topic, good[topic])

    def act() -> str:
        station: Any = Station()
        taken: list[MotionPlan] = []
        said = Diagnostics(station, lambda _: None)
        listener = PlanListener(station, said, members_in(folder), taken.append)
        try:
            for part in PARTS:
                station.hear(part, data if part == topic else good[part], MEMBERS[SCAN])
        except MalformedError:
            return "refused"
        if not listener.taken:
            return "waits"
        if [found.digest for found in taken] != [plan.digest]:
            raise AssertionError("another plan was accepted")
        return "answered"

    return told, act


def _of_bag(rng: random.Random, folder: Path, of: _Recorded) -> tuple[str, Callable[[], str]]:
    """Make a case that imports a recording with changed bytes or messages."""
    file, told = folder / "scan.mcap", ""
    if rng.random() < 0.4:
        data, told = broken(rng, of.file.read_bytes(), times=4)
        file.write_bytes(data)
    else:
        foreign = rng.random() < 0.4
        chosen = set(rng.sample(range(len(of.said)), min(rng.choice((1, 2, 10)), len(of.said))))
        few = [i for i, said in enumerate(of.said) if said[0] in {t.name for t in ANSWERS}]
        chosen |= set(rng.sample(few, 1))
        bag = Bag(file, 4096)
        if not foreign:
            for name, words in of.notes:
                bag.note(name, words)
            for name, content in of.attached:
                if rng.random() < 0.05:
                    content, what = broken(rng, content)
                    told += f"{name}: {what} "
                bag.attach(name, content)
        for i, (topic, kind, data, at) in enumerate(of.said):
            if i in chosen and topic in KINDS:
                data, what = _changed(rng, KINDS[topic], data)
                told += f"{what} "
            bag.write_raw(topic, kind, data, at, at, i)
        bag.close()
        told = f"foreign {told}" if foreign else told
    out = folder / "out"

    def act() -> str:
        try:
            found = import_scan([file], out)
        except InputError:
            if (out / "scan.zarr").exists():
                raise AssertionError("refused, but left a store") from None
            return "refused"
        if found.missing:
            return "in part"
        return "whole" if everything(load_scan(out)) == of.whole else "other"

    return told, act
