"""What the link carries arrives to the last bit, in the form any ROS tool understands."""

from dataclasses import replace

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from std_msgs.msg import Float64MultiArray

from twinct.geometry import Panel, Pose
from twinct.geometry.wire import PosePairs, Reached
from twinct.link import messages
from twinct.link.messages import MalformedError
from twinct.link.stamps import Epoch, Stamp
from twinct.scenario import stage_digests

STAMP = Stamp(1_700_000_123, 7)
REPROJECTION_PX = 1e-8
"""Column and row of one point by two formulas in double precision; images are 1000 px wide."""


def over_the_wire(message):
    return deserialize_message(serialize_message(message), type(message))


@pytest.fixture
def reached(random_pose):
    rng = np.random.default_rng(3)
    return Reached(
        executed=PosePairs.at(*(random_pose(rng) for _ in range(3))),
        joint_names=("source_a", "detector_a", "detector_b"),
        position=rng.normal(size=3),
        velocity=rng.normal(size=3),
        effort=rng.normal(size=3) * 1e-300,
        state=np.concatenate([rng.normal(size=40), [np.nextafter(0, 1), -0.0, 1e308]]),
        time_s=1 / 3,
        clearance_mm=float(np.nextafter(10, 11)),
        since_middle_s=1 / 7,
    )


def test_target_round_trip(random_pose):
    rng = np.random.default_rng(1)
    for _ in range(20):
        target = PosePairs.at(random_pose(rng), random_pose(rng))
        message = over_the_wire(messages.target_message(STAMP, target))
        assert messages.target_of(message) == target
        assert Stamp.of(message.header.stamp) == STAMP
        assert message.header.frame_id == "world"


def test_reached_round_trip(reached):
    poses = over_the_wire(messages.reached_message(STAMP, messages.executed(reached)))
    joints = over_the_wire(messages.joints_message(STAMP, reached))
    state = over_the_wire(messages.state_message(STAMP, reached))
    assert Stamp.of(joints.header.stamp) == messages.state_stamp(state) == STAMP

    messages.checked_joints(joints), messages.checked_state(state)
    back = messages.reached_of(messages.executed_of(poses), joints, state)

    for name in ("executed", "joint_names", "time_s", "clearance_mm", "since_middle_s"):
        assert getattr(back, name) == getattr(reached, name), name
    for name in ("position", "velocity", "effort", "state"):
        assert getattr(back, name).tobytes() == getattr(reached, name).tobytes(), name


def test_image_round_trip():
    image = np.random.default_rng(2).normal(size=(24, 32)).astype(np.float32)
    image[0, :3] = np.nextafter(np.float32(0), np.float32(1)), 3e38, -0.0

    message = over_the_wire(messages.image_message(STAMP, image))

    assert (message.height, message.width, message.step) == (24, 32, 128)
    assert (message.encoding, message.header.frame_id) == ("32FC1", "detector_optical")
    assert messages.image_of(message).tobytes() == image.tobytes()


def test_what_a_viewer_shows_stands_on_its_feet_in_a_fixed_window():
    image = np.array([[0, 0.25, 0.5], [-0.1, 1.0, 1.7]], np.float32)
    message = over_the_wire(messages.display_message(STAMP, image))
    assert (message.height, message.width, message.step) == (2, 3, 3)
    assert (message.encoding, message.header.frame_id) == ("mono8", "detector_optical")
    assert list(message.data) == [0, 255, 255, 0, 64, 128]
    assert Stamp.of(message.header.stamp) == STAMP


def spoilt(message, **attributes):
    for name, value in attributes.items():
        setattr(message, name, value)
    return message


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda m: spoilt(m, encoding="mono16"), "mono16.*32FC1"),
        (lambda m: spoilt(m, step=4), "4 bytes per row, expected 32FC1 with 12"),
        (lambda m: spoilt(m, data=m.data[:-4]), "20 bytes, expected 24"),
        (lambda m: spoilt(m, data=b"\0\0\xc0\x7f" * 6), "6 pixels are not finite"),
        (
            lambda _: messages.image_message(STAMP, np.ones((1, 1), "f4")),
            "1 x 1 px, expected 3 x 2",
        ),
        (
            lambda _: messages.image_message(STAMP, np.ones((1, 3), "f4")),
            "3 x 1 px, expected 3 x 2",
        ),
    ],
)
def test_what_is_no_image_of_the_panel_is_refused(spoil, reason):
    message = messages.image_message(STAMP, np.zeros((2, 3), np.float32))
    assert messages.image_of(message, (2, 3)).shape == (2, 3)
    with pytest.raises(MalformedError, match=reason):
        messages.image_of(spoil(message), (2, 3))


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda m: spoilt(m, data=[]), "data has 0 numbers, expected 46"),
        (lambda m: spoilt(m, data=m.data[:-1]), "data has 45 numbers, expected 46"),
        (lambda m: spoilt(m, data=[np.nan, *m.data[1:]]), "data holds numbers that are not finite"),
        (lambda m: m.layout.__setattr__("dim", []) or m, "no simulator state"),
        (lambda m: m.layout.dim[0].__setattr__("size", 0) or spoilt(m, data=m.data[:3]), "no sim"),
    ],
)
def test_what_is_no_state_is_refused(reached, spoil, reason):
    message = messages.state_message(STAMP, reached)
    with pytest.raises(MalformedError, match=reason):
        messages.checked_state(spoil(message))


@pytest.mark.parametrize(
    ("attributes", "reason"),
    [
        ({"name": []}, "no joints"),
        ({"effort": [1.0]}, "effort has 1 numbers, expected 3"),
        ({"velocity": [0.0, np.inf, 0.0]}, "velocity holds numbers that are not finite"),
    ],
)
def test_what_are_no_joints_is_refused(reached, attributes, reason):
    with pytest.raises(MalformedError, match=reason):
        messages.checked_joints(spoilt(messages.joints_message(STAMP, reached), **attributes))


def test_a_gantry_has_no_joints_and_no_clearance(reached):
    bare = replace(reached, joint_names=(), clearance_mm=np.nan)
    bare = replace(bare, **dict.fromkeys(("position", "velocity", "effort"), np.zeros(0)))
    joints, state = messages.joints_message(STAMP, bare), messages.state_message(STAMP, bare)
    messages.checked_joints(joints, arms=False), messages.checked_state(state, arms=False)
    assert np.isnan(state.data[1])
    with pytest.raises(MalformedError, match="not finite"):
        messages.checked_state(state)
    for index in (0, 2, 3):
        data = [np.inf if i == index else number for i, number in enumerate(state.data)]
        broken = spoilt(messages.state_message(STAMP, bare), data=data)
        with pytest.raises(MalformedError, match="not finite"):
            messages.checked_state(broken, arms=False)
    with pytest.raises(MalformedError, match="data has 0 numbers, expected 46"):
        messages.checked_state(spoilt(state, data=[]), arms=False)
    with pytest.raises(MalformedError, match="a gantry has no joints"):
        messages.checked_joints(messages.joints_message(STAMP, reached), arms=False)


def test_camera_info_projects_like_the_geometry(random_geometry):
    rng = np.random.default_rng(4)
    panel = Panel(480, 640, 0.5, 0.4)
    geometry = random_geometry(5, panel, rng)
    points = rng.uniform(-80, 80, (30, 3))
    for view in geometry:
        info = over_the_wire(messages.camera_message(STAMP, view))
        shown = over_the_wire(messages.camera_message(STAMP, view, display=True))
        axes = np.stack([view.u[0], -view.v[0], -view.normal[0]])
        np.testing.assert_allclose(np.cross(axes[0], axes[1]), axes[2], atol=1e-12)
        x, y, z = axes @ (points - view.source[0]).T
        k = np.array(info.k).reshape(3, 3)
        column, row, scale = k @ np.stack([x, y, z])
        expected = view.project(points)[0]
        np.testing.assert_allclose(column / scale, expected[:, 0], atol=REPROJECTION_PX)
        np.testing.assert_allclose(row / scale, expected[:, 1], atol=REPROJECTION_PX)
        assert k[0, 0] > 0 > k[1, 1]
        _, row, scale = np.array(shown.k).reshape(3, 3) @ np.stack([x, y, z])
        from_the_top = panel.rows - 1 - expected[:, 1]
        np.testing.assert_allclose(row / scale, from_the_top, atol=REPROJECTION_PX)
        assert shown.k[0] > 0 < shown.k[4] and shown.header == info.header
        np.testing.assert_array_equal(np.array(info.p).reshape(3, 4)[:, :3], k)
        assert (info.height, info.width) == panel.shape


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda message: message.poses.pop(), "1 poses, expected 2: source, detector"),
        (lambda message: setattr(message.header, "frame_id", "table"), "'table'.*'world'"),
        (lambda message: setattr(message.poses[0].orientation, "w", 2.0), "not a unit quaternion"),
        (lambda message: setattr(message.poses[1].position, "x", np.nan), "not finite"),
    ],
)
def test_what_is_no_target_is_refused(spoil, reason):
    message = messages.target_message(STAMP, PosePairs.at(Pose.identity(), Pose.identity()))
    spoil(message)
    with pytest.raises(MalformedError, match=reason):
        messages.target_of(message)


def test_a_reached_pose_that_is_none_is_named(reached):
    message = messages.reached_message(STAMP, messages.executed(reached))
    message.poses[1].position.y = np.nan
    with pytest.raises(MalformedError, match="pose 1, object_m: .*not finite"):
        messages.executed_of(message)


def test_epoch_follows_from_the_scenario_and_names_views(scenario):
    epoch = Epoch.of(stage_digests(scenario)["images"])
    assert Epoch.parse(str(epoch)) == epoch == Epoch.of(stage_digests(scenario)["images"])
    source = scenario.source.model_copy(update={"energy_kev": 71.0})
    assert epoch != Epoch.of(
        stage_digests(scenario.model_copy(update={"source": source}))["images"]
    )
    assert [epoch.view(epoch.at(view)) for view in (0, 7, 99_999)] == [0, 7, 99_999]
    assert epoch.view(Stamp(epoch.stamp.sec - 1, epoch.stamp.nanosec)) is None
    assert epoch.view(Stamp(epoch.stamp.sec, epoch.stamp.nanosec ^ 1)) is None
    over_the_wire(messages.clock_message(0.0))
    assert epoch.at(100_000).sec < 2**31


def test_state_without_a_stamp_belongs_to_no_view():
    assert messages.state_stamp(Float64MultiArray()) is None


def test_a_view_leads_from_when_it_was_taken_to_its_target():
    message = over_the_wire(messages.view_message(Stamp.at(1 / 3), STAMP, 5))
    assert Stamp.of(message.header.stamp) == Stamp(0, 333_333_333)
    assert (Stamp.of(message.time_ref), message.source) == (STAMP, "view 5")
    assert messages.view_message(STAMP, STAMP, None).source == "target"


def test_moving_joints_round_trip(reached):
    told = messages.joints_of(over_the_wire(messages.joints_message(STAMP, reached)))
    assert (told.joint_names, told.time_s) == (reached.joint_names, STAMP.time_s)
    for name in ("position", "velocity", "effort"):
        assert getattr(told, name).tobytes() == getattr(reached, name).tobytes(), name


def test_clock_carries_simulated_time():
    clock = messages.clock_message(12.3456789014).clock
    assert (clock.sec, clock.nanosec) == (12, 345678901)
