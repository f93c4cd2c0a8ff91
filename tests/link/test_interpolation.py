"""Joints and robot description are enough to know where source and panel were."""

import importlib.util
from pathlib import Path

import pytest
import trimesh
from std_msgs.msg import String

from twinct.geometry import Pose
from twinct.link import messages
from twinct.link.robots_node import RobotsNode, Turns
from twinct.link.senders import Sender
from twinct.link.stamps import Epoch, Stamp
from twinct.link.topics import CLOCK, DESCRIPTION, JOINTS, REACHED, TARGET, TF, TF_STATIC, VIEWS
from twinct.robots.cell import LinkFrames, build_cell, cell_urdf
from twinct.robots.motion import PursuingSimulation, Shutter, plan_motion
from twinct.scan import SimulationBuilder
from twinct.scenario import Cell, Detector, Motion, stage_digests

pytestmark = pytest.mark.ros

ROOT = Path(__file__).parents[2]
TICK_S = 0.02 + 1e-9
"""Fifty in a second; a stamp has whole nanoseconds."""


@pytest.fixture(scope="module")
def client():
    """The benchmark's: it shares no code with twinct."""
    file = ROOT / "benchmarks" / "interpolate_joints.py"
    spec = importlib.util.spec_from_file_location("interpolate_joints", file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def cell():
    hull = trimesh.creation.icosphere(radius=60)
    return build_cell(Cell(), hull, Pose.identity(), Detector().panel)


@pytest.mark.parametrize(
    ("motion", "shutter"),
    [
        (Motion(tool_speed_mm_s=125), Shutter(exposure_s=0.055, samples=5)),
        (Motion(trigger="settled"), None),
    ],
    ids=["moving", "settled"],
)
def test_interpolated_joints_give_the_executed_poses(
    client, cell, short, said, figure, motion, shutter
):
    epoch, targets = Epoch.of(stage_digests(short)["images"]), SimulationBuilder(short).targets
    robots = PursuingSimulation(cell, motion, plan_motion(cell, motion, targets), shutter)
    turns, urdf = Turns(epoch, targets, 0), cell_urdf(cell, Pose.identity())
    RobotsNode(said, said.diagnostics, robots, turns, None, urdf, LinkFrames(cell))
    for view, target in enumerate(targets):
        said.hears[TARGET](messages.target_message(epoch.at(view), target), Sender("0" * 32, 1, 1))
    assert len(said.of(REACHED)) == len(targets) and not said.diagnostics.refused
    heard = {topic.name: said.of(topic) for topic in (JOINTS, REACHED, DESCRIPTION)}
    off = client.offsets_mm({**heard, "/xray/image": said.of(VIEWS)})
    figure(f"{motion.trigger}: {off[..., 0].max():.4f} mm, {off[..., 1].max():.4f} deg")
    assert off[..., 0].max() < client.LARGEST_MM

    assert isinstance(said.of(DESCRIPTION)[0], String)
    for topic in (JOINTS, CLOCK):
        times = sorted({_stamp(message).time_s for message in said.of(topic)})
        assert max(b - a for a, b in zip(times, times[1:], strict=False)) < TICK_S
    _check_frames(said)
    now_s = 0.0
    for topic, message in said.said:
        if topic == CLOCK:
            now_s, then_s = _stamp(message).time_s, now_s
            assert now_s > then_s
        elif topic in (VIEWS, REACHED, JOINTS):
            assert _stamp(message).time_s <= now_s


def _check_frames(said):
    """Frames are told with each view, with its poses, and between the views as often as joints."""
    told = {}
    for message in said.of(TF):
        stamp = _stamp(message.transforms[0])
        assert stamp not in told
        told[stamp] = {one.child_frame_id: one.transform for one in message.transforms}
    for reached in said.of(REACHED):
        frames = told[_stamp(reached)]
        for name, pose in zip(("source", "specimen", "detector"), reached.poses, strict=False):
            place, told_at = pose.position, frames[name].translation
            assert (told_at.x, told_at.y, told_at.z) == (place.x, place.y, place.z)
        assert "source_wrist_3" in frames
    assert set(told) == {_stamp(message) for message in said.of(JOINTS)}
    [standing] = said.of(TF_STATIC)
    assert "table" in {one.child_frame_id for one in standing.transforms}


def _stamp(message):
    return Stamp.of(message.clock if hasattr(message, "clock") else message.header.stamp)
