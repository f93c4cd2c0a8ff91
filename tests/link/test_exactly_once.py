"""Each view is acquired once, whatever is lost, repeated or sent by strangers."""

import os
import sys
from contextlib import closing
from types import SimpleNamespace

import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseArray
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, JointState, TimeReference
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger
from waiting import HANG_S, until

from twinct.core.errors import LinkError, TargetRefusedError
from twinct.geometry.wire import PosePairs
from twinct.link import RosRig
from twinct.link.messages import diagnostic_values, executed_of, image_of, target_message
from twinct.link.node import Ledger, RefusedError
from twinct.link.processes import NodeProcess
from twinct.link.robots_node import Turns
from twinct.link.stamps import Epoch, Stamp
from twinct.link.topics import IMAGE
from twinct.scan import SimulationBuilder
from twinct.scenario import stage_digests

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
    return with_x(target, target.source[0].seven[0] + 1e-5)


def with_x(target, x_m):
    ((source, detector),) = target.sevens
    return PosePairs.from_sevens([((x_m, *source[1:]), detector)])


def home(somebody):
    """What the service answers to a node that asks for it."""
    return somebody.call(somebody.node.create_client(Trigger, "/scan/home"), Trigger.Request())


def ends_well(process):
    """Whether a node that is told to end does so by itself."""
    process.request_stop()
    until(lambda: process.exit_code is not None)
    assert process.exit_code == 0, process.describe_end()


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
        with pytest.raises(RefusedError, match="1.000000000 was already used with other poses"):
            ledger.find(Stamp(1, 0), "when")

    def test_a_forgotten_answer_is_not_worked_out_again(self):
        ledger = Ledger(keep=2)
        for second in range(3):
            ledger.enter(Stamp(second, 0), "where", second)
        assert ledger.find(Stamp(2, 0), "where") == 2
        with pytest.raises(RefusedError, match="already answered.*last 2"):
            ledger.find(Stamp(0, 0), "where")


def test_turns_let_only_the_next_view_of_the_scan_pass(scenario, targets):
    epoch = Epoch.of(stage_digests(scenario)["images"])
    turns = Turns(epoch, targets, first=1)
    for view, target, reason in [
        (0, targets[0], "view 1 comes next, not view 0"),
        (2, targets[2], "view 1 comes next, not view 2"),
        (1, elsewhere(targets[1]), "differs from the scan's target for view 1"),
        (12, targets[0], "the stamp of this target does not belong to it"),
    ]:
        with pytest.raises(RefusedError, match=reason):
            turns.check(epoch.at(view), target)
    turns.check(epoch.at(1), targets[1])
    turns.done()
    turns.check(epoch.at(2), targets[2])


class Disturbed:
    """A running scan, and a stranger on its domain."""

    def __init__(self, rig, stranger, targets, notes):
        self.rig, self.stranger, self.targets, self.notes = rig, stranger, targets, notes
        self.out = stranger.publisher("/scan/target", PoseArray)
        self.diagnostics = stranger.listen("/diagnostics", DiagnosticArray)
        self.reached = stranger.listen("/scan/reached", PoseArray)
        self.images = stranger.listen("/xray/image", Image)
        self.joints = stranger.listen("/joint_states", JointState)
        self.views = stranger.listen("/scan/views", TimeReference)
        stranger.until(self.out.get_subscription_count)
        self.next = 0

    def take(self):
        """Let the scan take its next view."""
        view = self.next
        self.next += 1
        return view, self.rig.move(view, self.targets[view]), self.rig.expose(view)

    def shout(self, view, target):
        self.out.publish(target_message(self.rig.epoch.at(view), target))

    def refusals(self):
        """What the stranger was refused."""
        return errors(self.diagnostics)

    @property
    def worked_once(self):
        """Whether each view was reached once, and imaged once."""
        return self.notes.count("move") == self.notes.count("render") == self.next


@pytest.fixture(scope="module")
def disturbed(scenario, targets, fake_command, foreign, lasting_notes):
    with pytest.MonkeyPatch.context() as patch:
        # However slow the machine is, the rig does not ask again.
        patch.setattr("twinct.link.rig.FIRST_REPEAT_S", HANG_S)
        with lasting_notes.for_nodes():
            rig = RosRig(scenario, node_command=fake_command)
        with closing(rig):
            yield Disturbed(rig, foreign(rig.domain_id), targets, lasting_notes)


def test_strangers_do_not_disturb_a_scan_and_can_follow_it(disturbed, targets):
    stranger, epoch = disturbed.stranger, disturbed.rig.epoch
    v, first, _ = disturbed.take()

    disturbed.out.publish(target_message(Stamp(17, 0), elsewhere(targets[v + 1])))
    disturbed.shout(v + 1, elsewhere(targets[v + 1]))
    disturbed.shout(v, elsewhere(targets[v]))
    disturbed.shout(v + 3, targets[v + 3])
    stranger.until(lambda: len(disturbed.refusals()) >= 4)
    for _ in range(3):
        disturbed.take()

    found = disturbed.refusals()
    assert [error["view"] for error in found] == ["", str(v + 1), str(v), str(v + 3)]
    for error, part in zip(
        found,
        ["does not belong to it", "the scan's target", "already used", f"view {v + 1} comes next"],
        strict=True,
    ):
        assert part in error["reason"]

    def told(messages):
        """Since this test began."""
        return [m for m in messages if Stamp.of(m.header.stamp) > taken(v)]

    views = range(v, v + 4)
    each = (disturbed.reached, disturbed.images, disturbed.views)
    stranger.until(
        lambda: all(len(told(m)) >= 4 for m in each) and len(told(disturbed.joints)) >= 8
    )
    expected = [taken(view + 1) for view in views]
    assert views_of(told(disturbed.views)) == {
        epoch.at(view): when for view, when in zip(views, expected, strict=True)
    }
    assert [message.source for message in told(disturbed.views)] == [f"view {v}" for v in views]
    for messages in (*map(told, each), told(disturbed.joints)[1::2]):
        assert [Stamp.of(message.header.stamp) for message in messages] == expected
    assert executed_of(told(disturbed.reached)[0]) == first.executed
    assert disturbed.worked_once


def test_no_clock_but_its_own_counts_in_a_scan(disturbed):
    """Another one jumps; no node of the scan hears it."""
    stranger = disturbed.stranger
    clock = stranger.publisher("/clock", Clock)
    heard = stranger.listen("/clock", Clock, latched=False)
    for sec in (10**9, 0, 2 * 10**9):
        clock.publish(Clock(clock=Time(sec=sec)))
    stranger.until(lambda: any(m.clock.sec == 2 * 10**9 for m in heard))
    disturbed.take()
    (mine,) = stranger.node.get_subscriptions_info_by_topic("/clock")
    assert mine.node_name == "somebody_else"
    each = disturbed.images, disturbed.reached
    last = taken(disturbed.next)
    stranger.until(lambda: all(Stamp.of(m[-1].header.stamp) == last for m in each))
    assert disturbed.worked_once
    stranger.node.destroy_publisher(clock)


def test_a_repeated_target_is_answered_from_memory(disturbed, targets):
    view, _, image = disturbed.take()

    def heard():
        return [m for m in disturbed.images if Stamp.of(m.header.stamp) == taken(view + 1)]

    disturbed.stranger.until(heard)
    for _ in range(3):
        disturbed.shout(view, targets[view])
    disturbed.stranger.until(lambda: len(heard()) >= 4)
    disturbed.take()
    for message in heard():
        assert image_of(message).tobytes() == image.tobytes()
    assert disturbed.worked_once


def test_the_rig_asks_again_when_an_answer_is_lost(disturbed, targets, monkeypatch):
    view, rig = disturbed.next, disturbed.rig
    disturbed.next += 1
    keep, ask, lost, asked = rig._keep, rig._target.publish, [], []

    def lossy(topic, *what):
        """Lose the image until the rig has asked again."""
        if topic == IMAGE and not asked:
            lost.append(topic)
        else:
            keep(topic, *what)

    def ask_again(message):
        if lost:
            asked.append(message)
        ask(message)

    with disturbed.notes.renders_held():
        rig.move(view, targets[view])
        monkeypatch.setattr(rig, "_keep", lossy)
        monkeypatch.setattr(rig, "_target", SimpleNamespace(publish=ask_again))
        monkeypatch.setattr("twinct.link.rig.FIRST_REPEAT_S", 0.02)
        monkeypatch.setattr(rig, "_answer_s", HANG_S)
    rig.expose(view)
    assert lost and asked
    assert disturbed.worked_once


def test_a_view_out_of_turn_is_refused_to_the_rig_too(disturbed, targets):
    with pytest.raises(TargetRefusedError, match=f"view 11: .*view {disturbed.next} comes next"):
        disturbed.rig.move(11, targets[11])
    disturbed.take()


def test_nobody_sends_the_arms_of_a_scan_home(disturbed):
    moves = disturbed.notes.count("move")
    answer = home(disturbed.stranger)
    assert not answer.success and answer.message.startswith("a scan is running")
    assert disturbed.notes.count("move") == moves
    disturbed.take()


def test_an_answer_that_never_comes_is_an_error(disturbed, targets):
    view, rig = disturbed.next, disturbed.rig
    disturbed.next += 1
    with disturbed.notes.renders_held(), pytest.MonkeyPatch.context() as patch:
        rig.move(view, targets[view])
        patch.setattr(rig, "_answer_s", 0.0)
        with pytest.raises(LinkError, match=f"no image for view {view} within"):
            rig.expose(view)
    rig.expose(view)


def test_a_foreign_node_drives_the_standalone_nodes(
    targets, fake_command, foreign, domain, node, notes, fakes
):
    somebody = foreign(domain)
    out = somebody.publisher("/scan/target", PoseArray)

    def listen(topic, kind):
        """As a node does that knows of no other way: it may miss what is said before it is met."""
        return somebody.listen(topic, kind, latched=False)

    reached = listen("/scan/reached", PoseArray)
    images = listen("/xray/image", Image)
    cameras = listen("/xray/camera_info", CameraInfo)
    states = listen("/scan/state", Float64MultiArray)
    views = listen("/scan/views", TimeReference)
    diagnostics = listen("/diagnostics", DiagnosticArray)
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
            each = (reached, images, cameras)
            told = {Stamp.of(m[-1].header.stamp) for m in each if m}
            return all((*each, states)) and told == {views_of(views).get(stamp)}

        message = target_message(stamp, target)
        somebody.ask(lambda message=message: out.publish(message), answered)
        assert views_of(views)[stamp] == taken(view + 1) and views[-1].source == "target"
    far = with_x(targets[0], fakes.REFUSED_X_M + 1)
    refused = target_message(Stamp(6, 0), far)
    somebody.ask(lambda: out.publish(refused), lambda: errors(diagnostics))
    assert errors(diagnostics)[0]["reason"] == "the source arm is too short"
    assert errors(diagnostics)[0]["stamp"] == "6.000000000"
    assert errors(diagnostics)[0]["arm"] == "source"
    notes.tell("short_arm", 1)
    answer = home(somebody)
    assert (answer.success, answer.message) == (False, "the source arm is too short")

    def of_home():
        return [error for error in errors(diagnostics) if error["stamp"] == "0.000000000"]

    somebody.until(of_home)
    assert of_home()[0]["arm"] == "source"
    for process in nodes:
        ends_well(process)
    assert (notes.count("move"), notes.count("render")) == (4, 4)


def test_a_late_x_ray_node_images_the_view_that_was_reached(
    targets, fake_command, foreign, domain, node, notes
):
    somebody = foreign(domain)
    out = somebody.publisher("/scan/target", PoseArray)
    images = somebody.listen("/xray/image", Image)
    reached = somebody.listen("/scan/reached", PoseArray)
    node(fake_command, "robots")
    somebody.until(out.get_subscription_count)
    out.publish(target_message(Stamp(5, 0), targets[0]))
    somebody.until(lambda: reached)
    node(fake_command, "xray")
    somebody.until(lambda: images)
    assert Stamp.of(images[0].header.stamp) == taken(1)
    assert notes.count("render") == 1


@pytest.mark.tutorial
def test_the_command_line_starts_the_real_nodes(short, foreign, domain, node):
    targets = SimulationBuilder(short).targets
    somebody = foreign(domain)
    out = somebody.publisher("/scan/target", PoseArray)
    images = somebody.listen("/xray/image", Image)
    reached = somebody.listen("/scan/reached", PoseArray)
    command = (sys.executable, "-m", "twinct", "node")
    nodes = [node(command, "robots", short), node(command, "xray", short)]
    somebody.until(out.get_subscription_count)
    message = target_message(Stamp(5, 0), targets[0])
    somebody.ask(lambda: out.publish(message), lambda: reached and images)
    source = executed_of(reached[0]).source[0].seven[:3]
    asked = targets[0].source[0].seven[:3]
    assert sum((a - b) ** 2 for a, b in zip(source, asked, strict=True)) ** 0.5 < 1.1e-3
    assert image_of(images[0]).min() < 0.9
    for process in nodes:
        ends_well(process)
