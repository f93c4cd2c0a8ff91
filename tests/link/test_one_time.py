"""All that a scan tells stands on one axis of time, and what has a stamp is known by it."""

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

from twinct.core.errors import TwinctError
from twinct.geometry import Pose
from twinct.link import messages
from twinct.link.robots_node import RobotsNode, Turns
from twinct.link.senders import Sender
from twinct.link.stamps import Epoch, Stamp
from twinct.link.topics import (
    CAMERA,
    CLOCK,
    DISPLAY,
    DISPLAY_CAMERA,
    HOME,
    IMAGE,
    JOINTS,
    REACHED,
    STATE,
    TARGET,
    VIEWS,
)
from twinct.link.xray_node import XRayNode
from twinct.robots.gantry import Gantry
from twinct.scenario import GantryCell, Source, stage_digests

pytestmark = pytest.mark.ros

SOMEBODY, ANOTHER = Sender("0" * 32, 1, 1), Sender("1" * 32, 1, 1)
ROUNDING_S = 1e-9
"""A stamp has whole nanoseconds."""


def stamps(said, topic):
    return [Stamp.of(message.header.stamp) for message in said.of(topic)]


def assert_one_time(said):
    """The clock goes on in steps of 20 ms at most, and before what has a stamp."""
    now_s = None
    for topic, message in said.said:
        if topic == CLOCK:
            then_s, now_s = now_s, Stamp.of(message.clock).time_s
            assert then_s is None or 0 < now_s - then_s < 0.02 + ROUNDING_S
        else:
            at = messages.state_stamp(message) if topic == STATE else Stamp.of(message.header.stamp)
            assert at.time_s <= now_s
            if topic in (REACHED, STATE):
                assert at in stamps(said, VIEWS)


@pytest.fixture
def driven(scenario, targets, said):
    """A robots node of a scan of so many views, after each was asked for twice."""

    def drive(robots, views=4, gone_home=False):
        epoch = Epoch.of(stage_digests(scenario)["images"])
        turns = None if gone_home else Turns(epoch, targets, 0)
        RobotsNode(said, said.diagnostics, robots, turns)
        for view in [*range(views), *range(views)]:
            message = messages.target_message(epoch.at(view), targets[view])
            said.hears[TARGET](message, SOMEBODY)
        assert not said.refused
        return epoch

    return drive


def test_the_clock_is_never_behind_and_no_stamp_comes_twice(driven, fakes, said):
    epoch = driven(fakes.FakeRobots())
    assert_one_time(said)
    # Asked again, the same is said again; only the clock does not go back, and of the views, which
    # are kept, only the last is told again.
    *views, again = said.of(VIEWS)
    assert stamps(said, REACHED) == 2 * [Stamp.of(message.header.stamp) for message in views]
    assert len(set(stamps(said, VIEWS))) == 4 and again == views[-1]
    for view, message in enumerate(views):
        assert (Stamp.of(message.time_ref), message.source) == (epoch.at(view), f"view {view}")
        assert Stamp.of(message.header.stamp) == Stamp.at((view + 1) / 3 - 1 / 300)
    assert len(said.of(JOINTS)) == 4 + 2 * 4, "on the way, and with each answer"


def test_a_driver_who_asks_again_hears_again_when_the_view_was(driven, fakes, said):
    driven(fakes.FakeRobots(), gone_home=True)
    assert stamps(said, REACHED) == stamps(said, VIEWS)
    assert {message.source for message in said.of(VIEWS)} == {"target"}


def test_on_the_way_home_time_goes_on_and_no_view_is_told_of(driven, fakes, said):
    from std_srvs.srv import Trigger

    driven(fakes.FakeRobots(), gone_home=True)
    before = len(said.said)
    answer = said.hears[HOME](Trigger.Request(), Trigger.Response())
    assert answer.success
    told = [topic for topic, _ in said.said[before:] if topic != CLOCK]
    assert told == [JOINTS, JOINTS, STATE]
    assert stamps(said, JOINTS)[-1] == Stamp.at(5 / 3 - 1 / 300)
    assert Stamp.of(said.of(CLOCK)[-1].clock) == Stamp.at(5 / 3)


def test_time_goes_on_with_a_gantry_that_stays_where_it_is(driven, targets, said):
    cell, place = GantryCell(kind="gantry", view_s=0.25), Pose.identity()
    robots = Gantry(cell, Source(), place)
    robots.move(0, targets[0])  # it is there already
    driven(robots)
    assert_one_time(said)
    assert [stamp.time_s for stamp in stamps(said, VIEWS)] == [0.5, 0.75, 1.0, 1.25, 1.25]


class Imager:
    def __init__(self, shape):
        self.image, self.views = np.zeros(shape, np.float32), []

    def expose(self, path, view=0, before=None, *, time_s=0.0):
        self.views.append(view)
        return self.image


@pytest.fixture
def xray(scenario, said):
    panel = scenario.detector.panel

    def make(epoch):
        imager = Imager(panel.shape)
        XRayNode(said, said.diagnostics, imager, panel, epoch)
        return imager

    return make


def poses_at(stamp, target):
    return messages.reached_message(stamp, replace(target, object=target.source))


@pytest.mark.parametrize("poses_first", [True, False])
def test_an_image_is_of_the_view_that_was_reached_then(xray, scenario, targets, poses_first, said):
    epoch, taken = Epoch.of(stage_digests(scenario)["images"]), Stamp(3, 7)
    imager = xray(epoch)
    both = [
        (REACHED, poses_at(taken, targets[5])),
        (VIEWS, messages.view_message(taken, epoch.at(5), 5)),
    ]
    for topic, message in both if poses_first else both[::-1]:
        assert not said.of(IMAGE)
        said.hears[topic](message, SOMEBODY)
    assert imager.views == [5]
    for topic in (IMAGE, CAMERA, DISPLAY, DISPLAY_CAMERA):
        assert stamps(said, topic) == [taken]


def test_a_view_of_another_scan_is_refused(xray, scenario, targets, said):
    epoch = Epoch.of(stage_digests(scenario)["images"])
    xray(epoch)
    said.hears[VIEWS](messages.view_message(Stamp(3, 7), Stamp(5, 5), 0), SOMEBODY)
    said.hears[REACHED](poses_at(Stamp(3, 7), targets[0]), SOMEBODY)
    assert not said.of(IMAGE)
    [(stamp, text)] = said.refused
    assert stamp == Stamp(5, 5) and "does not belong to it" in text


def test_two_robots_nodes_have_each_a_clock_of_their_own(xray, targets, said):
    imager = xray(None)
    said.hears[REACHED](poses_at(Stamp(3, 7), targets[0]), SOMEBODY)
    said.hears[REACHED](poses_at(Stamp(3, 7), targets[1]), ANOTHER)
    said.hears[REACHED](poses_at(Stamp(3, 7), targets[0]), SOMEBODY)
    assert imager.views == [3_000_000_007] * 2 and len(said.of(IMAGE)) == 3
    said.hears[REACHED](poses_at(Stamp(3, 7), targets[1]), SOMEBODY)
    assert "already used with other poses" in said.refused[0][1]


def test_a_time_before_all_time_keys_no_noise_and_is_refused(xray, targets, said):
    xray(None)
    said.hears[REACHED](poses_at(Stamp(-5, 7), targets[0]), SOMEBODY)
    assert not said.of(IMAGE) and "negative" in said.refused[0][1]


def test_what_cannot_be_imaged_is_refused_and_ends_nothing(xray, targets, said):
    imager = xray(None)
    imager.expose = Mock(side_effect=TwinctError("the source is inside the specimen"))
    said.hears[REACHED](poses_at(Stamp(3, 7), targets[0]), SOMEBODY)
    assert not said.of(IMAGE) and "inside the specimen" in said.refused[0][1]
