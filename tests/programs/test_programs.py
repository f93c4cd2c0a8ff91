"""Plans as files for controllers: the same joints at the same times, read back independently."""

from __future__ import annotations

import csv
import io
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from twinct.core.errors import InputError, ScanExistsError
from twinct.robots.motion import MotionPlan
from twinct.robots.programs import language_named, languages, program_of, write_program
from twinct.scan import SimulationBuilder
from twinct.scenario import load_scenario

SCENARIO = {
    "trajectory": {"kind": "arc", "views": 8, "longitude_range_deg": 10},
    "specimen": {
        "parts": [{"shape": {"kind": "sphere", "radius_mm": 50, "mesh_resolution_mm": 8}}]
    },
    "detector": {"frame_ms": 40},
}
NAMES = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")


@pytest.fixture(scope="module")
def plan() -> MotionPlan:
    plan = SimulationBuilder(load_scenario(SCENARIO)).plan
    assert plan is not None
    return plan


def written(plan: MotionPlan, to: str, *prefixes: str) -> dict[str, str]:
    program = program_of(plan, "a test", (prefixes[0], prefixes[1]) if prefixes else ("", ""))
    return dict(language_named(to).write(program))


def test_every_program_has_the_times_and_poses_of_its_views(plan: MotionPlan) -> None:
    for name in languages():
        rows = list(csv.DictReader(io.StringIO(written(plan, name)["triggers.csv"])))
        assert [int(row["view"]) for row in rows] == list(range(8))
        assert [float(row["time_s"]) for row in rows] == plan.exposures_s.tolist()
        poses = [[float(value) for value in list(row.values())[2:]] for row in rows]
        assert poses == [[n for pose in t[0] for n in pose.seven] for t in plan.targets]


def test_a_joint_trajectory_holds_the_plan_to_the_last_bit(plan: MotionPlan) -> None:
    files = written(plan, "joint-trajectory", "left_", "right_")
    for side, prefix, part in (
        ("source", "left_", slice(0, 6)),
        ("detector", "right_", slice(6, 12)),
    ):
        told = yaml.safe_load(files[f"{side}_trajectory.yaml"])
        assert told["joint_names"] == [f"{prefix}{name}_joint" for name in NAMES]
        for key, order in (("positions", 0), ("velocities", 1), ("accelerations", 2)):
            values = np.array([point[key] for point in told["points"]])
            np.testing.assert_array_equal(values, plan.state[:, order, part])
        since = [point["time_from_start"] for point in told["points"]]
        assert [t["sec"] * 10**9 + t["nanosec"] for t in since] == np.rint(
            plan.time_s * 1e9
        ).tolist()
    both = yaml.safe_load(files["both_trajectory.yaml"])["joint_names"]
    assert both == [f"{p}{name}_joint" for p in ("left_", "right_") for name in NAMES]
    same = yaml.safe_load(written(plan, "joint-trajectory")["both_trajectory.yaml"])
    assert same["joint_names"] == list(plan.joint_names)


def test_ros_takes_a_joint_trajectory(plan: MotionPlan) -> None:
    pytest.importorskip("rclpy")
    from trajectory_msgs.msg import JointTrajectory

    from twinct.link.messages import ros_message

    told = yaml.safe_load(written(plan, "joint-trajectory")["source_trajectory.yaml"])
    message: Any = ros_message(JointTrajectory, told)
    assert list(message.points[5].positions) == plan.state[5, 0, :6].tolist()


def test_the_table_is_read_back(plan: MotionPlan) -> None:
    head, *rows = csv.reader(io.StringIO(written(plan, "csv")["plan.csv"]))
    assert head[:3] == ["time_s", "view", "source_shoulder_pan_joint_rad"]
    assert head[-1] == "detector_wrist_3_joint_rad_s2" and len(head) == 2 + 36
    views = [-1 if row[1] == "" else int(row[1]) for row in rows]
    assert views == plan.views.tolist()
    assert [float(row[0]) for row in rows] == plan.time_s.tolist()
    states = np.array([row[2:] for row in rows], float).reshape(plan.state.shape)
    np.testing.assert_array_equal(states, plan.state)


def test_a_rail_has_metres(plan: MotionPlan) -> None:
    railed = replace(
        plan,
        joint_names=("source_rail", *plan.joint_names),
        state=np.insert(plan.state, 0, 0.0, axis=2),
    )
    head = written(railed, "csv")["plan.csv"].splitlines()[0].split(",")
    assert [name for name in head if "rail" in name] == [
        "source_rail_m",
        "source_rail_m_s",
        "source_rail_m_s2",
    ]
    with pytest.raises(InputError, match="7 joints"):
        written(railed, "urscript")


@pytest.mark.parametrize("side", ["source", "detector"])
def test_a_script_reaches_each_view_at_its_time(plan: MotionPlan, side: str) -> None:
    part = slice(0, 6) if side == "source" else slice(6, 12)
    time_s, joints, high, views, lines = 0.0, np.zeros(6), False, list[int](), 0
    for line in written(plan, "urscript")[f"{side}.script"].splitlines():
        if call := re.match(r"  servoj\(\[(.*)\], t=([\d.]+), ", line):
            step = float(call[2])
            assert 0.002 <= step <= 0.0161
            time_s, lines = time_s + step, lines + 1
            joints = np.array(call[1].split(", "), float)
            np.testing.assert_allclose(joints, plan.at(np.array([time_s]))[0, 0, part], atol=1e-5)
        elif trigger := re.match(r"  set_digital_out\(0, (True|False)\)(?:  # view (\d+))?", line):
            if trigger[1] == "True":
                assert not high, "the output falls before it rises again"
                views.append(int(trigger[2]))
                assert time_s == pytest.approx(plan.exposures_s[views[-1]], abs=1e-4)
                np.testing.assert_allclose(joints, plan.joints[views[-1], part], atol=1e-8)
            high = trigger[1] == "True"
    assert views == list(range(8)) and not high
    assert time_s == pytest.approx(plan.duration_s, abs=1e-3)


def test_other_arms_and_views_too_fast_have_no_script(plan: MotionPlan) -> None:
    seven = replace(
        plan,
        joint_names=(*plan.joint_names[:6], "source_seventh", *plan.joint_names[6:]),
        state=np.insert(plan.state, 6, 0.0, axis=2),
    )
    with pytest.raises(InputError, match="the source arm has 7 joints; arms of Universal Robots"):
        written(seven, "urscript")
    hurry = np.diff(plan.exposures_s).min() / 0.003
    with pytest.raises(InputError, match=r"within 3.0 ms; two calls of servoj take at least 4 ms"):
        written(replace(plan, time_s=plan.time_s / hurry), "urscript")


def test_names_and_folders_that_cannot_be(plan: MotionPlan, tmp_path) -> None:
    with pytest.raises(InputError, match="--to krl: unknown; choose from joint-trajectory, csv"):
        language_named("krl")
    write_program(tmp_path / "new" / "plan", {"a.txt": "text"})
    assert (tmp_path / "new" / "plan" / "a.txt").read_text() == "text"
    with pytest.raises(ScanExistsError, match="exists already"):
        write_program(tmp_path / "new" / "plan", {})
    with pytest.raises(InputError, match="is not a folder"):
        write_program(tmp_path / "new" / "plan" / "a.txt" / "b", {})


def test_a_folder_appears_when_it_is_complete(monkeypatch, tmp_path) -> None:
    def killed(*_: object, **__: object) -> None:
        assert not (tmp_path / "plan").exists()
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "write_text", killed)
    with pytest.raises(KeyboardInterrupt):
        write_program(tmp_path / "plan", {"a.txt": "text"})
    assert not [*tmp_path.iterdir()]
