"""Who answers must be a node that the scan started: nobody else's answers are used."""

from contextlib import closing

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Float64MultiArray
from waiting import HANG_S, until

from twinct.core.errors import LinkError
from twinct.link import RosRig, messages
from twinct.link.node import Diagnostics
from twinct.link.participant import Station
from twinct.link.senders import Members
from twinct.link.stamps import Stamp
from twinct.link.topics import IMAGE, JOINTS, REACHED, STATE, VIEWS
from twinct.scan import LocalRig

pytestmark = [pytest.mark.ros, pytest.mark.process]

LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
TOPICS = (VIEWS, REACHED, JOINTS, STATE, IMAGE)
NAME = "somebody_else"
"""Of a foreign node."""


def test_a_message_tells_who_sent_it_whatever_its_node_is_called(domain, tmp_path):
    heard = []
    with (
        closing(Station("listener", domain)) as listener,
        closing(Station("robots", domain)) as one,
        closing(Station("robots", domain)) as other,
    ):
        members = Members(tmp_path)
        assert not members.knows("robots")
        listener.listen(STATE, lambda m, s: heard.append((m, s)))
        members.enter("robots", one.participant)
        for station, value in ((one, 1.0), (other, 2.0), (one, 3.0)):
            out = station.publisher(STATE)
            out.publish(Float64MultiArray(data=[value]))
            count = len(heard) + 1
            assert listener.wait(lambda count=count: len(heard) == count, HANG_S)
            assert heard[-1][0].data[0] == value
        assert [members.sent("robots", sender) for _, sender in heard] == [True, False, True]
        assert len({sender for _, sender in heard}) == 3
        assert one.participant != other.participant == heard[1][1].participant
        # The name is discovered later than the endpoint.
        sender = heard[1][1]
        assert listener.wait(lambda: "'robots'" in listener.name_of(STATE.name, sender), HANG_S)


def test_bytes_that_are_no_message_are_told_once_and_end_nothing(domain):
    """Whoever was on the domain could end a node so."""
    heard, told = [], []
    with (
        closing(Station("listener", domain)) as listener,
        closing(Station("stranger", domain)) as stranger,
    ):
        said = Diagnostics(listener, told.append)
        listener.listen(STATE, lambda m, s: heard.append(m.data[0]))
        out = stranger.publisher(STATE)
        assert stranger.wait(out.get_subscription_count, HANG_S)
        for data in (b"\0\1\0", b"\0\1\0\0\xff\xff\xff\xff", b"\0\1\0\0"):
            out.publish(data)
        out.publish(Float64MultiArray(data=[3.0]))
        assert listener.wait(lambda: heard, HANG_S)
    assert heard == [3.0]
    assert told == list(said.strangers.values()) and len(told) == 1
    assert f"do not fit the message type of {STATE.name}" in told[0]


def test_ctrl_c_while_a_message_is_read_ends_the_waiting(domain, monkeypatch):
    def interrupted(message, data):
        raise KeyboardInterrupt

    with (
        closing(Station("listener", domain)) as listener,
        closing(Station("speaker", domain)) as speaker,
    ):
        listener.listen(STATE, lambda *heard: None)
        speaker.publisher(STATE).publish(Float64MultiArray(data=[3.0]))
        monkeypatch.setattr(Float64MultiArray, "layout", property(None, interrupted))
        with pytest.raises(KeyboardInterrupt):
            listener.wait(lambda: False, HANG_S)


def names_of_publishers(rig, topic):
    return {info.node_name for info in rig._station._node.get_publishers_info_by_topic(topic.name)}


class Forger:
    """A stranger who answers the scan's targets before its nodes do."""

    def __init__(self, stranger, rig, scenario, fakes):
        self.stranger, self.rig, self.fakes = stranger, rig, fakes
        self.shape = scenario.detector.panel.shape
        self.out = {
            topic: stranger.node.create_publisher(topic.message_class, topic.name, LATCHED)
            for topic in TOPICS
        }
        self.diagnostics = stranger.listen("/diagnostics", DiagnosticArray)
        stranger.until(
            lambda: (
                all(out.get_subscription_count() for out in self.out.values())
                and self.out[REACHED].get_subscription_count() >= 3
                and self.out[VIEWS].get_subscription_count() >= 2
            )
        )
        until(
            lambda: all(NAME in names_of_publishers(rig, topic) for topic in TOPICS),
            "the rig knows the stranger's name",
        )

        self.read = []
        tell = rig._diagnostics.stranger

        def read(topic, sender):
            self.read.append(topic)
            tell(topic, sender)

        rig._diagnostics.stranger = read

    def answer(self, view, target, image, state=None):
        """Forge all answers to a target; the rig has read them then."""
        robots = self.fakes.FakeRobots()
        robots.moves = view
        stamp = Stamp.at(robots.move(view, target).middle_s)  # that of the true answer
        robots.moves = 40
        reached = robots.move(view, target)
        forged = messages.state_message(stamp, reached)
        if state is not None:
            forged.data = state
        for topic, message in {
            VIEWS: messages.view_message(Stamp.at(99), self.rig.epoch.at(view), view),
            REACHED: messages.reached_message(stamp, messages.executed(reached)),
            JOINTS: messages.joints_message(stamp, reached),
            STATE: forged,
            IMAGE: messages.image_message(stamp, image),
        }.items():
            self.out[topic].publish(message)
        count = len(self.read) + len(TOPICS)
        assert self.rig._station.wait(lambda: len(self.read) == count, HANG_S)

    def warnings(self):
        return [
            (status.name, messages.diagnostic_values(status.values)["topic"])
            for message in self.diagnostics
            for status in message.status
            if status.level == DiagnosticStatus.WARN
        ]


def test_forged_answers_change_nothing_and_are_named_once(
    scenario, targets, fake_command, foreign, fakes, caplog
):
    forgeries = [
        {"image": np.ones((1, 1), np.float32)},
        {"image": np.ones((1, scenario.detector.columns), np.float32)},
        {"image": np.ones(scenario.detector.panel.shape, np.float32)},
        {"image": np.full((3, 5), np.nan, np.float32), "state": []},
        {"image": np.ones((1, 1), np.float32), "state": [np.nan] * 8},
    ]
    local = LocalRig(
        fakes.FakeRobots(), fakes.FakeImager(scenario.detector), scenario.detector.panel
    )
    with closing(RosRig(scenario, node_command=fake_command)) as rig:
        forger = Forger(foreign(rig.domain_id), rig, scenario, fakes)
        for view, forged in enumerate(forgeries):
            forger.answer(view, targets[view], **forged)
            reached, true = rig.move(view, targets[view]), local.move(view, targets[view])
            forger.answer(view, targets[view], **forged)
            image = rig.expose(view)
            assert image.tobytes() == local.expose(view).tobytes()
            assert reached.state.tobytes() == true.state.tobytes()
            assert (reached.executed, reached.time_s) == (true.executed, true.time_s)
        # A true view after all that was forged: who answers it has read that.
        rig.move(len(forgeries), targets[len(forgeries)])
        rig.expose(len(forgeries))
        forger.stranger.until(lambda: len(forger.warnings()) >= 7)
        log = (rig.log_dir / "xray.log").read_text()
    told = sorted(forger.warnings())
    assert told == sorted(
        [("twinct_scan", topic.name) for topic in TOPICS]
        + [("twinct_xray", topic.name) for topic in (REACHED, VIEWS)]
    )
    assert log.count("not part of this scan") == 2, "as often as it is said on the topic"
    words = [
        record.getMessage() for record in caplog.records if "not part of this scan" in record.msg
    ]
    assert len(words) == len(TOPICS)
    assert all(f"'{NAME}'" in line for line in words)


def test_an_image_of_another_shape_ends_the_scan_by_name(scenario, targets, fake_command, notes):
    with closing(RosRig(scenario, node_command=fake_command)) as rig:
        notes.tell("one_pixel", 1)
        try:
            with pytest.raises(LinkError, match=r"/xray/image of view 0: 1 x 1 px, expected 32 x"):
                rig.move(0, targets[0])  # the image may be there before the state
                rig.expose(0)
        finally:
            notes.tell("one_pixel", 0)


def test_an_answer_that_does_not_come_names_the_strangers(
    scenario, targets, fake_command, foreign, fakes, notes
):
    with closing(RosRig(scenario, node_command=fake_command, answer_s=0.0)) as rig:
        forger = Forger(foreign(rig.domain_id), rig, scenario, fakes)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(rig, "_answer_s", HANG_S)  # but for the answer that does not come
            rig.move(0, targets[0])
            rig.expose(0)
            forger.answer(1, targets[1], np.ones((1, 1), np.float32))
            with notes.renders_held(1):
                rig.move(1, targets[1])
                patch.undo()
                with pytest.raises(LinkError, match=f"no image for view 1 .*'{NAME}', which is"):
                    rig.expose(1)


def test_a_refusal_by_a_stranger_refuses_nothing(scenario, targets, fake_command, foreign):
    with closing(RosRig(scenario, node_command=fake_command)) as rig:
        stranger = foreign(rig.domain_id)
        out = stranger.node.create_publisher(DiagnosticArray, "/diagnostics", LATCHED)
        stranger.until(out.get_subscription_count)
        for name in ("twinct_xray", "twinct_robots"):
            out.publish(
                messages.diagnostic_message(
                    rig.epoch.at(0), name, messages.ERROR, "no", {"target": "everything"}
                )
            )
        stranger.delivered(out)
        rig.move(0, targets[0])
        rig.expose(0)
