"""Two cells in one graph, in namespaces of their own, and a foreign client of both."""

from __future__ import annotations

import json
from collections.abc import Iterator
from threading import Event, Thread
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")

from geometry_msgs.msg import PoseArray
from rcl_interfaces.srv import GetParameters, SetParameters
from sensor_msgs.msg import Image, JointState
from waiting import HANG_S

from twinct.cli import run_command
from twinct.core.errors import InputError
from twinct.link.environment import ROS_ARGUMENTS, take_ros_arguments
from twinct.link.messages import target_message
from twinct.link.node import Diagnostics
from twinct.link.participant import Station
from twinct.link.robots_node import RobotsNode
from twinct.link.stamps import Stamp
from twinct.link.topics import TF
from twinct.link.xray_node import XRayNode
from twinct.robots.cell import LinkFrames
from twinct.scan import SimulationBuilder
from twinct.scenario import load_scenario

pytestmark = pytest.mark.process

SCENARIO = {
    "trajectory": {"kind": "arc", "views": 3, "longitude_range_deg": 4},
    "specimen": {
        "parts": [{"shape": {"kind": "sphere", "radius_mm": 50, "mesh_resolution_mm": 8}}]
    },
    "detector": {"columns": 16, "rows": 12, "pixel_pitch_mm": 20},
    "xray": {"engine": "mesh"},
}


class Cell:
    """Both nodes of a cell in a namespace, each in a thread."""

    def __init__(self, domain: int, name: str, builder: SimulationBuilder, imager: Any) -> None:
        names = ["-r", f"__ns:=/{name}", "-r", f"/{name}/xray/image:=/{name}/pictures"]
        told = {"scenario": builder.scenario.resolved()}
        self._stations = [
            Station(f"twinct_{node}", domain, ros_arguments=names, parameters=told)
            for node in ("robots", "xray")
        ]
        self.robots, self._imager = builder.robots(), imager
        robots, xray = self._stations
        links = LinkFrames(builder.cell)
        self.nodes = (
            RobotsNode(robots, quiet(robots), self.robots, links=links),
            XRayNode(xray, quiet(xray), self._imager, builder.scenario.detector.panel),
        )
        self._ending = Event()
        self._threads = [
            Thread(target=station.wait, args=(self._ending.is_set, HANG_S))
            for station in self._stations
        ]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        self._ending.set()
        for station, thread in zip(self._stations, self._threads, strict=True):
            station.wake()
            thread.join()
            station.close()
        self.robots.close()


def quiet(station: Station) -> Diagnostics:
    return Diagnostics(station, lambda _: None)


@pytest.fixture(scope="module")
def builder() -> SimulationBuilder:
    return SimulationBuilder(load_scenario(SCENARIO))


@pytest.fixture
def cells(domain: int, builder: SimulationBuilder, fakes: Any) -> Iterator[dict[str, Cell]]:
    imager = fakes.FakeImager(builder.scenario.detector.panel)
    made = {name: Cell(domain, name, builder, imager) for name in ("cell_a", "cell_b")}
    yield made
    for cell in made.values():
        cell.close()


def test_each_cell_answers_its_own_targets(
    cells: dict[str, Cell], builder: SimulationBuilder, foreign: Any, domain: int
) -> None:
    client = foreign(domain)
    heard: dict[str, dict[str, list[Any]]] = {}
    for view, name in enumerate(cells):
        heard[name] = {
            "reached": client.listen(f"/{name}/scan/reached", PoseArray),
            "image": client.listen(f"/{name}/pictures", Image),
            "joints": client.listen(f"/{name}/joint_states", JointState),
        }
        out = client.publisher(f"/{name}/scan/target", PoseArray)
        client.until(out.get_subscription_count)
        target = target_message(Stamp(7, view), builder.targets[view])
        client.ask(lambda out=out, t=target: out.publish(t), lambda n=name: heard[n]["image"])
    for view, name in enumerate(cells):
        pose = heard[name]["reached"][-1].poses[0].position
        wanted = builder.targets[view].source[0].seven[:3]
        assert np.linalg.norm(np.subtract((pose.x, pose.y, pose.z), wanted)) < 0.001
        assert len({bytes(m.data) for m in heard[name]["image"]}) == 1
    topics = {name for name, _ in client.node.get_topic_names_and_types()}
    assert not topics & {"/scan/target", "/joint_states", "/clock", "/xray/image", "/tf"}
    assert {"/cell_a/tf", "/cell_b/clock", "/cell_b/pictures"} <= topics


def test_frames_are_told_in_standard_messages(
    cells: dict[str, Cell], builder: SimulationBuilder, foreign: Any, domain: int
) -> None:
    client, kind = foreign(domain), TF.message_class
    moving = client.listen("/cell_a/tf", kind)
    standing = client.listen("/cell_a/tf_static", kind)
    out = client.publisher("/cell_a/scan/target", PoseArray)
    client.until(out.get_subscription_count)
    target = target_message(Stamp(7, 0), builder.targets[2])
    client.ask(lambda: out.publish(target), lambda: moving and standing)
    names = [{f.child_frame_id for f in m[-1].transforms} for m in (moving, standing)]
    assert {"source", "detector", "specimen", "detector_optical"} < names[0]
    assert any("wrist" in name for name in names[0])
    assert not names[0] & names[1]
    assert any("base" in name for name in names[1])
    assert {f.header.frame_id for f in moving[-1].transforms} == {"world"}


def test_parameters_are_readable_and_nothing_else(
    cells: dict[str, Cell], foreign: Any, domain: int
) -> None:
    client = foreign(domain)
    get = client.node.create_client(GetParameters, "/cell_a/twinct_robots/get_parameters")
    answer = client.call(get, GetParameters.Request(names=["scenario"]))
    assert json.loads(answer.values[0].string_value)["detector"]["columns"] == 16
    set_ = client.node.create_client(SetParameters, "/cell_a/twinct_robots/set_parameters")
    from rcl_interfaces.msg import Parameter, ParameterValue

    changed = Parameter(name="scenario", value=ParameterValue(type=4, string_value="{}"))
    assert not client.call(set_, SetParameters.Request(parameters=[changed])).results[0].successful


def test_arguments_of_ros_are_taken_from_the_command_line() -> None:
    try:
        rest = take_ros_arguments(["node", "robots", "s.yaml", "--ros-args", "-r", "__ns:=/a"])
        assert rest == ["node", "robots", "s.yaml"]
        assert ROS_ARGUMENTS == ["-r", "__ns:=/a"]
        rest = take_ros_arguments(["node", "--ros-args", "-r", "a:=b", "--", "xray", "s.yaml"])
        assert rest == ["node", "xray", "s.yaml"]
    finally:
        ROS_ARGUMENTS.clear()


def test_wrong_arguments_of_ros_are_named(domain: int) -> None:
    with pytest.raises(InputError, match="--ros-args -r nonsense: "):
        Station("wrong", domain, ros_arguments=["-r", "nonsense"])
    assert run_command(["node", "robots", "/nowhere.yaml", "--ros-args", "-r", "a:=b"]) == 2
    ROS_ARGUMENTS.clear()
