"""Each topic of a scan has one publisher, a node that the scan started; a second one ends it."""

from contextlib import closing

import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import Float64MultiArray
from waiting import HANG_S, until

from twinct.core.errors import LinkError
from twinct.link import RosRig, messages
from twinct.link.node import Diagnostics
from twinct.link.participant import Station
from twinct.link.senders import Members
from twinct.link.topics import IMAGE, JOINTS, REACHED, STATE, VIEWS
from twinct.scan import LocalRig

pytestmark = [pytest.mark.ros, pytest.mark.process]

LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
TOPICS = (VIEWS, REACHED, JOINTS, STATE, IMAGE)
NAME = "somebody_else"
"""Of a foreign node."""


def test_a_message_has_a_sender_while_its_topic_has_one_publisher(domain, tmp_path):
    heard = []
    with (
        closing(Station("listener", domain)) as listener,
        closing(Station("robots", domain)) as one,
        closing(Station("robots", domain)) as other,
    ):

        def hear(out, value):
            out.publish(Float64MultiArray(data=[value]))
            count = len(heard) + 1
            assert listener.wait(lambda: len(heard) == count, HANG_S)
            assert heard[-1][0].data[0] == value
            return heard[-1][1].participant

        members = Members(tmp_path)
        assert not members.knows("robots")
        listener.listen(STATE, lambda m, s: heard.append((m, s)))
        members.enter("robots", one.participant)
        assert one.participant != other.participant
        first = one.publisher(STATE)
        assert members.has("robots", hear(first, 1.0))
        second = other.publisher(STATE)
        assert {hear(second, 2.0), hear(first, 3.0)} == {""}, "nobody can tell them apart"
        other._node.destroy_publisher(second)
        until(lambda: listener._node.count_publishers(STATE) == 1)
        assert hear(first, 4.0) == one.participant
        assert len({sender for _, sender in heard}) == 4
        # The name is discovered later than the endpoint.
        assert listener.wait(
            lambda: listener.names_on(STATE, members._known["robots"].__eq__) == "a node 'robots'",
            HANG_S,
        )


def test_who_takes_the_port_of_one_that_left_is_heard(domain):
    """A sweep of ports that others still sent to cut off every third participant that came."""
    with closing(Station("listener", domain)) as listener:
        listener.listen(STATE, lambda *heard: None)
        for number in range(8):
            name = f"guest_{number}"
            with closing(Station(name, domain)) as guest:
                guest.publisher(STATE)
                assert listener.wait(
                    lambda name=name: name in listener.names_on(STATE, bool), HANG_S
                ), name


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


@pytest.mark.parametrize("topic", TOPICS)
def test_a_second_publisher_ends_the_scan_by_name_and_with_no_wrong_data(
    topic, scenario, targets, fake_command, foreign, fakes
):
    local = LocalRig(
        fakes.FakeRobots(), fakes.FakeImager(scenario.detector.panel), scenario.detector.panel
    )
    with closing(RosRig(scenario, node_command=fake_command)) as rig:
        reached, true = rig.move(0, targets[0]), local.move(0, targets[0])
        assert (reached.executed, reached.time_s) == (true.executed, true.time_s)
        assert rig.expose(0).tobytes() == local.expose(0).tobytes()
        publishing = rig._station.names_on

        def named():
            return NAME in publishing(topic, lambda who: who != rig._station.participant)

        stranger = foreign(rig.domain_id)
        out = stranger.node.create_publisher(topic.message_class, topic.name, LATCHED)
        stranger.until(out.get_subscription_count)
        until(named, "the stranger's name is discovered")
        words = f"a node '{NAME}', which is not part of this scan, publishes on {topic}: end it"
        with pytest.raises(LinkError, match=words):
            rig.move(1, targets[1])
            rig.expose(1)


def test_an_image_of_another_shape_ends_the_scan_by_name(scenario, targets, fake_command, notes):
    with closing(RosRig(scenario, node_command=fake_command)) as rig:
        notes.tell("one_pixel", 1)
        try:
            with pytest.raises(LinkError, match=r"/xray/image of view 0: 1 x 1 px, expected 32 x"):
                rig.move(0, targets[0])  # the image may be there before the state
                rig.expose(0)
        finally:
            notes.tell("one_pixel", 0)


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
