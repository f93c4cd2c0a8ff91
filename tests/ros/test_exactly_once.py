"""Each view is acquired once, whatever is lost, repeated or sent by strangers."""

import os
import sys
import time
from contextlib import closing

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseArray
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, JointState, TimeReference
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from twinct.errors import LinkError, TargetRefusedError
from twinct.ros import RosRig
from twinct.ros.messages import (
    Epoch,
    Stamp,
    diagnostic_values,
    executed_of,
    image_of,
    target_message,
)
from twinct.ros.node import Ledger, RefusedError
from twinct.ros.processes import NodeProcess
from twinct.ros.robots_node import Turns
from twinct.ros.topics import IMAGE
from twinct.scan import Workshop
from twinct.views import Target

pytestmark = [pytest.mark.ros, pytest.mark.process]


def errors(diagnostics):
    return [
        diagnostic_values(status.values)
        for message in diagnostics
        for status in message.status
        if status.level == DiagnosticStatus.ERROR
    ]


def taken(moves):
    """When the tiny robots take the view after so many moves."""
    return Stamp.at(moves / 3 - 1 / 300)


def views_of(messages):
    """When each target was reached, by the target's stamp."""
    return {Stamp.of(m.time_ref): Stamp.of(m.header.stamp) for m in messages}


def elsewhere(target):
    return Target((target.source_m[0] + 1e-9, *target.source_m[1:]), target.detector_m)


def home(somebody):
    """What the service answers to a node that asks for it."""
    client = somebody.node.create_client(Trigger, "/scan/home")
    somebody.until(client.service_is_ready)
    future = client.call_async(Trigger.Request())
    somebody.until(future.done)
    return future.result()


@pytest.fixture
def node(tmp_path, scenario):
    """Starts standalone nodes, as ``twinct node`` does."""
    started = []

    def start(command, which, of=scenario):
        file = tmp_path / f"{which}.json"
        file.write_text(of.resolved())
        process = NodeProcess(
            which,
            [*command, which, str(file)],
            tmp_path / f"{which}.log",
            environment=os.environ,
            on_end=lambda _: None,
        )
        started.append(process)
        return process

    yield start
    for process in started:
        process.stop()


class TestLedger:
    def test_a_question_is_new_once(self):
        ledger = Ledger()
        assert ledger.find(Stamp(1, 0), "where") is None
        ledger.enter(Stamp(1, 0), "where", "there")
        assert ledger.find(Stamp(1, 0), "where") == "there"

    def test_a_stamp_stands_for_one_question(self):
        ledger = Ledger()
        ledger.enter(Stamp(1, 0), "where", "there")
        with pytest.raises(RefusedError, match="1.000000000 was used before with other poses"):
            ledger.find(Stamp(1, 0), "when")

    def test_a_forgotten_answer_is_not_worked_out_again(self):
        ledger = Ledger(keep=2)
        for second in range(3):
            ledger.enter(Stamp(second, 0), "where", second)
        assert ledger.find(Stamp(2, 0), "where") == 2
        with pytest.raises(RefusedError, match="answered already.*last 2"):
            ledger.find(Stamp(0, 0), "where")


def test_turns_let_only_the_next_view_of_the_scan_pass(scenario, targets):
    epoch = Epoch.of(scenario)
    turns = Turns(epoch, targets, first=1)
    for view, target, reason in [
        (0, targets[0], "view 1 comes next, not view 0"),
        (2, targets[2], "view 1 comes next, not view 2"),
        (1, elsewhere(targets[1]), "none of its own: view 1 has others"),
        (12, targets[0], "none of its stamps"),
    ]:
        with pytest.raises(RefusedError, match=reason):
            turns.check(epoch.at(view), target)
    turns.check(epoch.at(1), targets[1])
    turns.done()
    turns.check(epoch.at(2), targets[2])


class Disturbed:
    """A running scan, and a stranger on its domain."""

    def __init__(self, rig, stranger, targets):
        self.rig, self.stranger, self.targets = rig, stranger, targets
        self.out = stranger.publisher("/scan/target", PoseArray)
        self.diagnostics = stranger.listen("/diagnostics", DiagnosticArray)
        self.reached = stranger.listen("/scan/reached", PoseArray)
        self.images = stranger.listen("/xray/image", Image)
        self.joints = stranger.listen("/joint_states", JointState)
        self.views = stranger.listen("/scan/views", TimeReference)
        self.clock = stranger.listen("/clock", Clock)
        stranger.until(
            lambda: (
                self.out.get_subscription_count()
                and all(stranger.node.count_publishers(topic) for topic in stranger.heard)
            )
        )
        self.next = 0

    def take(self):
        """Let the scan take its next view."""
        view = self.next
        self.next += 1
        return view, self.rig.move(view, self.targets[view]), self.rig.expose(view)

    def shout(self, view, target):
        self.out.publish(target_message(self.rig.epoch.at(view), target))


@pytest.fixture(scope="module")
def disturbed(scenario, targets, fake_command, foreign, notes):
    with closing(RosRig(scenario, node_command=fake_command)) as rig:
        yield Disturbed(rig, foreign(rig.domain_id), targets)


def test_strangers_do_not_disturb_a_scan_and_can_follow_it(disturbed, targets, notes):
    stranger, epoch = disturbed.stranger, disturbed.rig.epoch
    _, first, _ = disturbed.take()

    disturbed.out.publish(target_message(Stamp(17, 0), elsewhere(targets[1])))
    disturbed.shout(1, elsewhere(targets[1]))
    disturbed.shout(0, elsewhere(targets[0]))
    disturbed.shout(3, targets[3])
    stranger.until(lambda: len(errors(disturbed.diagnostics)) >= 4)
    for _ in range(3):
        disturbed.take()
    stranger.until(lambda: len(disturbed.images) >= 4 and len(disturbed.joints) >= 8)

    found = errors(disturbed.diagnostics)
    assert [error["view"] for error in found] == ["", "1", "0", "3"]
    for error, part in zip(
        found, ["its stamps", "has others", "used before", "view 1 comes next"], strict=True
    ):
        assert part in error["reason"]
    expected = [taken(view + 1) for view in range(4)]
    assert views_of(disturbed.views) == {epoch.at(v): expected[v] for v in range(4)}
    assert [message.source for message in disturbed.views] == [f"view {v}" for v in range(4)]
    for messages in (disturbed.reached, disturbed.images, disturbed.joints[1::2]):
        assert [Stamp.of(message.header.stamp) for message in messages] == expected
    assert executed_of(disturbed.reached[0]).view == first.executed
    assert notes.count("move") == notes.count("render") == disturbed.next


def test_a_repeated_target_is_answered_from_memory(disturbed, targets, notes):
    view, _, image = disturbed.take()
    disturbed.stranger.stay(0.3)
    before = len(disturbed.images)
    for _ in range(3):
        disturbed.shout(view, targets[view])
    disturbed.stranger.until(lambda: len(disturbed.images) >= before + 3)
    disturbed.take()
    for message in disturbed.images[before : before + 3]:
        assert image_of(message).tobytes() == image.tobytes()
    assert notes.count("move") == notes.count("render") == disturbed.next


def test_the_rig_asks_again_when_an_answer_is_lost(disturbed, targets, notes, monkeypatch):
    view = disturbed.next
    disturbed.next += 1
    notes.render_takes(0.5)
    disturbed.rig.move(view, targets[view])
    keep, lost = disturbed.rig._keep, []
    monkeypatch.setattr(
        disturbed.rig,
        "_keep",
        lambda topic, *what: keep(topic, *what) if lost else lost.append(topic),
    )
    start = time.monotonic()
    disturbed.rig.expose(view)
    notes.render_takes(0)
    assert lost == [IMAGE] and time.monotonic() - start > 1.0
    assert notes.count("move") == notes.count("render") == disturbed.next


def test_a_view_out_of_turn_is_refused_to_the_rig_too(disturbed, targets):
    with pytest.raises(TargetRefusedError, match=f"view 11: .*view {disturbed.next} comes next"):
        disturbed.rig.move(11, targets[11])
    disturbed.take()


def test_nobody_sends_the_arms_of_a_scan_home(disturbed, notes):
    moves = notes.count("move")
    answer = home(disturbed.stranger)
    assert not answer.success and answer.message.startswith("a scan is running")
    assert notes.count("move") == moves
    disturbed.take()


def test_an_answer_that_never_comes_is_an_error(disturbed, targets, notes, monkeypatch):
    notes.render_takes(3)
    monkeypatch.setattr(disturbed.rig, "_answer_s", 0.5)
    disturbed.rig.move(disturbed.next, targets[disturbed.next])
    with pytest.raises(LinkError, match="no image of view .* within"):
        disturbed.rig.expose(disturbed.next)
    notes.render_takes(0)


def test_a_foreign_node_drives_the_standalone_nodes(
    targets, fake_command, foreign, domain, node, notes, fakes
):
    moves, renders = notes.count("move"), notes.count("render")
    somebody = foreign(domain)
    out = somebody.publisher("/scan/target", PoseArray)
    reached = somebody.listen("/scan/reached", PoseArray)
    images = somebody.listen("/xray/image", Image)
    cameras = somebody.listen("/xray/camera_info", CameraInfo)
    states = somebody.listen("/scan/state", Float64MultiArray)
    views = somebody.listen("/scan/views", TimeReference)
    diagnostics = somebody.listen("/diagnostics", DiagnosticArray)
    nodes = [node(fake_command, "robots"), node(fake_command, "xray")]
    somebody.until(
        lambda: (
            out.get_subscription_count() >= 1
            and somebody.node.count_publishers("/xray/image") == 1
            and somebody.node.count_subscribers("/scan/reached") >= 3
        )
    )
    for view, target in enumerate(targets[:4]):
        stamp = Stamp(5, view)
        states.clear()

        def answered(stamp: Stamp = stamp) -> bool:  # an answer to one before may come late
            told = {Stamp.of(m[-1].header.stamp) for m in (reached, images, cameras) if m}
            return told == {views_of(views).get(stamp)} and bool(states)

        somebody.ask(out, target_message(stamp, target), answered)
        assert views_of(views)[stamp] == taken(view + 1) and views[-1].source == "target"
    far = Target((fakes.REFUSED_X_M + 1, *targets[0].source_m[1:]), targets[0].detector_m)
    somebody.ask(out, target_message(Stamp(6, 0), far), lambda: errors(diagnostics))
    assert errors(diagnostics)[0]["reason"] == "the source arm is too short"
    assert errors(diagnostics)[0]["stamp"] == "6.000000000"
    assert errors(diagnostics)[0]["arm"] == "source"
    notes.tell("short_arm", 1)
    refused = home(somebody)
    notes.tell("short_arm", 0)
    assert (refused.success, refused.message) == (False, "the source arm is too short")
    somebody.until(lambda: errors(diagnostics)[-1]["stamp"] == "0.000000000")
    assert errors(diagnostics)[-1]["arm"] == "source"
    for process in nodes:
        process.stop()
        assert process.exit_code == 0, process.describe_end()
    assert (notes.count("move"), notes.count("render")) == (moves + 4, renders + 4)


def test_a_late_x_ray_node_images_the_view_that_was_reached(
    targets, fake_command, foreign, domain, node, notes
):
    renders = notes.count("render")
    somebody = foreign(domain)
    out = somebody.publisher("/scan/target", PoseArray)
    images = somebody.listen("/xray/image", Image)
    reached = somebody.listen("/scan/reached", PoseArray)
    node(fake_command, "robots")
    somebody.until(lambda: out.get_subscription_count() >= 1)
    somebody.ask(out, target_message(Stamp(5, 0), targets[0]), lambda: reached)
    node(fake_command, "xray")
    somebody.ask(out, target_message(Stamp(5, 0), targets[0]), lambda: images)
    assert Stamp.of(images[0].header.stamp) == taken(1)
    assert notes.count("render") == renders + 1


@pytest.mark.tutorial
def test_the_command_line_starts_the_real_nodes(short, foreign, domain, node):
    targets = Workshop(short).targets
    somebody = foreign(domain)
    out = somebody.publisher("/scan/target", PoseArray)
    images = somebody.listen("/xray/image", Image)
    reached = somebody.listen("/scan/reached", PoseArray)
    command = (sys.executable, "-m", "twinct", "node")
    nodes = [node(command, "robots", short), node(command, "xray", short)]
    somebody.until(lambda: out.get_subscription_count() >= 1, timeout_s=60)
    message = target_message(Stamp(5, 0), targets[0])
    somebody.ask(out, message, lambda: reached and images, timeout_s=60)
    source = executed_of(reached[0]).view.source_m[:3]
    asked = targets[0].source_m[:3]
    assert sum((a - b) ** 2 for a, b in zip(source, asked, strict=True)) ** 0.5 < 1.1e-3
    assert image_of(images[0]).min() < 0.9
    for process in nodes:
        process.stop()
        assert process.exit_code == 0, process.describe_end()
