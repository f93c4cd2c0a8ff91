"""What a scan over the local link says, read by a library that shares no code with its writer."""

import io
import re
from collections import Counter

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from yourdfpy import URDF

from twinct.geometry import Pose
from twinct.link.recording import recordings
from twinct.scan import ScanStore

VIEWS = 4

ROUNDING_M, ROUNDING_PX = 1e-6, 1e-6
"""The description has its numbers as texts; a point is projected by two formulas."""


@pytest.fixture(scope="module")
def said(taken):
    """All messages by topic, with the stores of types that the file has."""
    found = {}
    with AnyReader([taken.folder / "scan.mcap"]) as reader:
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            found.setdefault(connection.topic, []).append((connection.msgtype, data, message))
    return found


def test_every_message_is_there(said, taken):
    counts = Counter({topic: len(messages) for topic, messages in said.items()})
    counts.pop("/clock")
    assert (
        counts.pop("/joint_states")
        >= 50 * ScanStore(taken.folder / "scan.zarr").read().simulated_s[-1]
    )
    once = {"/scan/plan": 1, "/scan/plan_views": 1, "/scan/commanded": 1, "/robot_description": 1}
    each = ("target", "reached", "state", "views")
    topics = [f"/scan/{name}" for name in each] + ["/tf", "/xray/image", "/xray/camera_info"]
    topics += ["/xray/display", "/xray/display/camera_info"]
    for topic in topics:
        assert counts.pop(topic) == VIEWS, topic
    assert counts == once


def test_types_are_those_that_another_library_knows(said):
    """The definitions in the file give the fields that rosbags' own definitions give."""
    known = get_typestore(Stores.ROS2_JAZZY)
    for messages in said.values():
        for kind, data, message in messages:
            expected = re.sub(r"\b[A-Z]+=\d+, ", "", repr(known.deserialize_cdr(data, kind)))
            assert expected == repr(message), "but for constants, which the file does not have"


def test_numbers_are_those_of_the_store(said, taken):
    scan = ScanStore(taken.folder / "scan.zarr").read()
    answers = [m.header.stamp for _, _, m in said["/scan/views"]]
    joints = {(m.header.stamp.sec, m.header.stamp.nanosec): m for *_, m in said["/joint_states"]}
    for view, stamp in enumerate(answers):
        for topic in ("/scan/reached", "/xray/image", "/xray/camera_info"):
            assert said[topic][view][2].header.stamp == stamp, topic
        image = said["/xray/image"][view][2]
        assert image.data.tobytes() == scan.transmission[view].tobytes()
        at = joints[stamp.sec, stamp.nanosec]
        assert at.position.tobytes() == scan.joints[view].tobytes()
        assert tuple(at.name) == scan.simulated.joint_names
        p, q = (
            getattr(said["/scan/reached"][view][2].poses[0], n) for n in ("position", "orientation")
        )
        pose = Pose.from_metres([p.x, p.y, p.z], [q.x, q.y, q.z, q.w])
        assert (pose.position == scan.executed.source[view].position).all()
        assert (pose.quat == scan.executed.source[view].quat).all()


def test_frames_project_a_point_where_the_panel_has_it(said, taken):
    """A point seen through /tf and the camera falls on the pixel that the geometry says."""
    scan, panel = (
        ScanStore(taken.folder / "scan.zarr").read(),
        taken.builder.scenario.detector.panel,
    )
    point = np.array([20.0, -30.0, 10.0])
    for view in range(VIEWS):
        frames = {t.child_frame_id: t.transform for t in said["/tf"][view][2].transforms}
        assert {"source", "specimen", "detector", "detector_optical"} < set(frames)
        at = frames["detector_optical"]
        t, q = at.translation, at.rotation
        world_from_camera = Pose.from_metres([t.x, t.y, t.z], [q.x, q.y, q.z, q.w])
        x, y, z = world_from_camera.inverse().apply(point)
        k = said["/xray/camera_info"][view][2].k
        pixel = k[0] * x / z + k[2], k[4] * y / z + k[5]
        column, row = scan.executed.geometry(panel)[view].project(point[None])[0].ravel()
        assert np.allclose(pixel, (column, row), atol=ROUNDING_PX)


def test_links_are_where_the_description_has_them(said):
    """By another library's forward kinematics, from the joints at the stamp."""
    ((_, _, described),) = said["/robot_description"]
    robot = URDF.load(io.BytesIO(described.data.encode()), load_meshes=False)
    joints = {(m.header.stamp.sec, m.header.stamp.nanosec): m for *_, m in said["/joint_states"]}
    own = {"source", "detector", "detector_optical"}  # executed, not computed
    for *_, message in said["/tf"]:
        stamp = message.transforms[0].header.stamp
        at = joints[stamp.sec, stamp.nanosec]
        robot.update_cfg(dict(zip(at.name, at.position.tolist(), strict=True)))
        links = {t.child_frame_id: t.transform for t in message.transforms}
        assert set(robot.link_map) - {"world"} <= set(links)
        for name in set(robot.link_map) - own - {"world"}:
            t, q = links[name].translation, links[name].rotation
            found = Pose(np.array([t.x, t.y, t.z]), np.array([q.x, q.y, q.z, q.w])).matrix
            assert np.allclose(found, robot.get_transform(name), atol=ROUNDING_M), name


def test_the_same_scan_gives_the_same_file(take, taken, tmp_path):
    again = take(tmp_path / "again")
    assert (again.folder / "scan.mcap").read_bytes() == (taken.folder / "scan.mcap").read_bytes()


def test_a_resumed_scan_writes_one_more(take, tmp_path):
    """Nothing to take, nothing recorded; files are told in the order in which they were made."""
    for number in (2, 10, 1):
        (tmp_path / f"scan_{number}.mcap").touch()
    assert [path.name for path in recordings(tmp_path)] == [
        "scan_1.mcap",
        "scan_2.mcap",
        "scan_10.mcap",
    ]
