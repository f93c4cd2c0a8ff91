"""What a system ROS is told to start fits the graph: names, types, QoS, frames, joints."""

import ast
from pathlib import Path
from xml.etree import ElementTree as Xml

import pytest
import yaml
from geometry_msgs.msg import PoseArray
from sensor_msgs.msg import Image
from std_msgs.msg import String

from twinct.geometry import Pose
from twinct.link import messages, plain
from twinct.link.stamps import Stamp
from twinct.link.topics import DESCRIPTION, TOPICS
from twinct.robots.cell import build_cell, cell_urdf
from twinct.scenario import Cell, Detector

pytestmark = pytest.mark.ros

EXAMPLES = Path(__file__).parents[2] / "examples"
KINDS = {"RobotModel": String, "PoseArray": PoseArray, "Image": Image}
"""What RViz's displays take."""


@pytest.fixture(scope="module")
def nodes():
    """Arguments of each node of the launch file, by executable, as it spells them."""
    tree = ast.parse((EXAMPLES / "room.launch.py").read_text())
    calls = [n for n in ast.walk(tree) if isinstance(n, ast.Call)]
    found = [c for c in calls if isinstance(c.func, ast.Name) and c.func.id == "Node"]
    arguments = [{k.arg: k.value for k in call.keywords} for call in found]
    return {ast.literal_eval(of["executable"]): of for of in arguments}


@pytest.fixture(scope="module")
def rviz():
    return yaml.safe_load((EXAMPLES / "room.rviz").read_text())["Visualization Manager"]


@pytest.fixture(scope="module")
def links():
    cell = build_cell(Cell(), None, Pose.identity(), Detector().panel)
    urdf = Xml.fromstring(cell_urdf(cell, Pose.identity()))
    return {link.get("name") for link in urdf.iter("link")}


def parameters_of(node):
    [given] = node["parameters"].elts
    return {ast.literal_eval(k): v for k, v in zip(given.keys, given.values, strict=True)}


def test_the_launch_file_starts_both_on_the_scans_clock(nodes):
    assert set(nodes) == {"robot_state_publisher", "rviz2"}
    for name, node in nodes.items():
        assert ast.literal_eval(node["package"]) == name
        assert ast.literal_eval(parameters_of(node)["use_sim_time"]) is True
    publisher = parameters_of(nodes["robot_state_publisher"])
    # Joints of an exposure that takes its time have an older stamp than the last before them.
    assert ast.literal_eval(publisher["ignore_timestamp"]) is True
    assert "robot_description" in publisher
    assert {"/joint_states", "/clock"} <= {topic.name for topic in TOPICS}
    assert (EXAMPLES / "room.rviz").exists() and "room.rviz" in ast.unparse(
        ast.parse((EXAMPLES / "room.launch.py").read_text())
    )


def test_rviz_shows_what_there_is_as_it_is_published(nodes, rviz):
    remapped = dict(ast.literal_eval(nodes["robot_state_publisher"]["remappings"]))
    room = remapped.pop(DESCRIPTION.name.removeprefix("/"))
    # The scan's own frames are the only ones on /tf.
    assert remapped.keys() == {"tf", "tf_static", "/tf", "/tf_static"}
    assert not set(remapped.values()) & {"/tf", "/tf_static"}
    kinds = {topic.name: topic.message_class for topic in TOPICS} | {room: String}
    assert room not in {topic.name for topic in TOPICS}
    shown = 0
    for display in rviz["Displays"]:
        topic = display.get("Topic") or display.get("Description Topic")
        if topic is not None:
            kind = KINDS[display["Class"].removeprefix("rviz_default_plugins/")]
            assert kinds[topic["Value"]] is kind, display["Name"]
            qos = topic["Reliability Policy"], topic["Durability Policy"]
            assert qos == ("Reliable", "Transient Local")
            shown += 1
    assert shown == 4
    assert {display["Class"] for display in rviz["Displays"]} >= {"rviz_default_plugins/TF"}


def test_frames_are_those_of_robot_description_and_messages(rviz, links):
    frames = next(d["Frames"] for d in rviz["Displays"] if d["Class"].endswith("/TF"))
    named = {name for name in frames if name != "All Enabled"}
    grid = {d["Reference Frame"] for d in rviz["Displays"] if "Reference Frame" in d}
    view = rviz["Views"]["Current"]["Target Frame"]
    assert {*named, *grid, view, rviz["Global Options"]["Fixed Frame"]} <= links
    assert {plain.WORLD, plain.OPTICAL, "source", "detector"} <= links
    assert messages.target_message(Stamp(0, 0), _anywhere()).header.frame_id in links


def _anywhere():
    here = (0.0,) * 6 + (1.0,)
    return messages.PosePairs.from_sevens([(here, here)])


def test_the_launch_file_of_a_cell_starts_its_nodes_in_a_namespace(monkeypatch):
    """With stand-ins for the packages of a system ROS, as the command line takes it apart."""
    import runpy
    import sys
    from types import ModuleType, SimpleNamespace

    from twinct.link.environment import ROS_ARGUMENTS, take_ros_arguments

    started = []
    fakes = {
        "launch": {"LaunchDescription": list},
        "launch.actions": {
            "DeclareLaunchArgument": lambda name, **_: name,
            "ExecuteProcess": lambda **said: started.append(SimpleNamespace(**said)),
        },
        "launch.substitutions": {"LaunchConfiguration": lambda name: f"<{name}>"},
    }
    for name, content in fakes.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
    made = runpy.run_path(str(EXAMPLES / "cell.launch.py"))["generate_launch_description"]()
    assert made[:2] == ["scenario", "cell"]
    try:
        for process, node in zip(started, ("robots", "xray"), strict=True):
            command, *arguments = ["".join(part) for part in process.cmd]
            assert command == "twinct"
            assert take_ros_arguments(arguments) == ["node", node, "<scenario>"]
            assert ROS_ARGUMENTS == ["-r", "__ns:=/<cell>"]
    finally:
        ROS_ARGUMENTS.clear()
