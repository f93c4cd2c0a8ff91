"""Drive a standalone robots node to random targets, one after the other, as a stranger would.

    python benchmarks/drive_nodes.py                      # 200 targets, both rolls as they come
    python benchmarks/drive_nodes.py --roll free --out out/driven_free.jsonl
    python benchmarks/judge_driven.py out/driven.jsonl    # what the answers are worth

The client knows ROS 2's standard messages and docs/ros.md; nothing of twinct is imported. Each
answer is a line of JSON, so that what was cut off goes on where it stopped, from home. Seconds are
those of the clock from sending a target to its answer, and of the node's processor in between.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Pose, PoseArray
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

RADIUS_M = 0.3
"""Of source and panel about the isocentre."""

PATIENCE_S = 120.0
"""Longer than any answer may take: the node hangs."""

START_S = 600.0
"""Time for the node to start."""

LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def quaternion(axes: np.ndarray) -> np.ndarray:
    """(x, y, z, w) of a rotation matrix: the eigenvector of Bar-Itzhack's symmetric matrix."""
    r = axes
    k = np.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], 0, 0, 0],
            [r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], 0, 0],
            [r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1], 0],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], np.trace(r)],
        ]
    )
    return np.linalg.eigh(k / 3, "L")[1][:, -1]


def random_targets(number: int, seed: int) -> list[list[list[float]]]:
    """Source and panel opposite each other, anywhere on the sphere, turned by any angle.

    Returns:
        for each target both poses, each as x, y, z in m and a quaternion (x, y, z, w).
    """
    rng = np.random.default_rng(seed)
    targets = []
    for _ in range(number):
        normal, u = np.linalg.qr(rng.normal(size=(3, 2)))[0].T * rng.choice([-1.0, 1.0])
        panel = np.column_stack([u, np.cross(normal, u), normal])
        source = np.column_stack([u, -np.cross(normal, u), -normal])
        poses = [(RADIUS_M * normal, source), (-RADIUS_M * normal, panel)]
        targets.append([[*place.tolist(), *quaternion(axes).tolist()] for place, axes in poses])
    return targets


class Driver:
    """Knows topics, a service, and the process that answers."""

    def __init__(self, process: subprocess.Popen) -> None:
        self._process = process
        rclpy.init()
        self.node = node = rclpy.create_node("stranger")
        self.heard: dict[str, Any] = {}
        self._out = node.create_publisher(PoseArray, "/scan/target", LATCHED)
        self._home = node.create_client(Trigger, "/scan/home")
        for topic, kind in {
            "/scan/reached": PoseArray,
            "/joint_states": JointState,
            "/scan/state": Float64MultiArray,
        }.items():
            node.create_subscription(
                kind, topic, lambda message, topic=topic: self._hear(topic, message), LATCHED
            )
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, LATCHED)
        self._until(self._home.service_is_ready, START_S)

    def home(self) -> tuple[bool, str]:
        self.heard.clear()
        future = self._home.call_async(Trigger.Request())
        self._until(future.done, PATIENCE_S)
        answer = future.result()
        assert answer is not None
        if answer.success:
            self._until(self._at_rest, PATIENCE_S)
        return answer.success, answer.message

    def joints(self) -> list[float]:
        self._until(lambda: "/joint_states" in self.heard, PATIENCE_S)
        return list(self.heard["/joint_states"].position)

    def drive(self, number: int, poses: list[list[float]]) -> dict[str, Any]:
        """Send a target and wait for its answer."""
        message = PoseArray()
        message.header.frame_id, message.header.stamp.sec = "world", number + 1
        message.poses = [pose_of(numbers) for numbers in poses]
        start = self.joints()
        self.heard.clear()
        self._asked = number + 1
        begin, processor = time.monotonic(), self.processor_s()
        self._out.publish(message)

        def answered() -> bool:
            return "refused" in self.heard or ("/scan/reached" in self.heard and self._at_rest())

        self._until(answered, PATIENCE_S)
        line: dict[str, Any] = {
            "target": number,
            "poses": poses,
            "start": start,
            "seconds": round(time.monotonic() - begin, 3),
            "processor_s": round(self.processor_s() - processor, 2),
        }
        if "refused" in self.heard:
            self.heard["/joint_states"] = JointState(position=start)  # the arms are where they were
            return {**line, "refused": self.heard["refused"]}
        reached, state = self.heard["/scan/reached"], self.heard["/scan/state"].data
        executed = [numbers_of(reached.poses[k]) for k in (0, 2)]
        return {
            **line,
            "executed": executed,
            "joints": self.joints(),
            "simulated_s": state[0],
            "clearance_mm": state[1],
        }

    def _at_rest(self) -> bool:
        """The last joints heard are those of the answer, not of the way."""
        state, joints = (self.heard.get(topic) for topic in ("/scan/state", "/joint_states"))
        if state is None or joints is None:
            return False
        stamp = joints.header.stamp
        return state.layout.dim[0].label == f"{stamp.sec}.{stamp.nanosec:09d}"

    def _hear(self, topic: str, message: object) -> None:
        self.heard[topic] = message

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            about = message.header.stamp.sec
            if status.level == DiagnosticStatus.ERROR and about == self._asked:
                values = {pair.key: pair.value for pair in status.values}
                self.heard["refused"] = {key: values[key] for key in ("arm", "reason")}

    def processor_s(self) -> float:
        fields = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def _until(self, done: Callable[[], object], seconds: float) -> None:
        deadline = time.monotonic() + seconds
        while not done():
            if self._process.poll() is not None:
                raise SystemExit("the node has ended")
            if time.monotonic() > deadline:
                raise SystemExit(f"no answer within {seconds:g} s")
            rclpy.spin_once(self.node, timeout_sec=0.1)


def pose_of(numbers: list[float]) -> Pose:
    pose = Pose()
    (place, turn) = (pose.position, pose.orientation)
    place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w = numbers
    return pose


def numbers_of(pose: Pose) -> list[float]:
    place, turn = pose.position, pose.orientation
    return [place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--scenario", default="scenarios/demo.yaml")
    parser.add_argument("--targets", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--roll", choices=["fixed", "free"], default="fixed")
    parser.add_argument("--domain", type=int, default=88)
    parser.add_argument("--out", type=Path, default=Path("out/driven.jsonl"))
    args = parser.parse_args()
    args.out.parent.mkdir(parents=True, exist_ok=True)
    done = len(args.out.read_text().splitlines()) if args.out.exists() else 0
    os.environ["ROS_DOMAIN_ID"] = str(args.domain)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    rolls = [f"motion.{arm}_roll={args.roll}" for arm in ("source", "detector")]
    # As fast as the joints let it: scenarios that extend the paper keep its slow tools.
    keys = ["motion.scheme=planned", "motion.tool_speed_mm_s=null", *rolls]
    sets = [part for key in keys for part in ("--set", key)]
    command = [sys.executable, "-m", "twinct", "node", "robots", args.scenario, *sets]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
        try:
            driver = Driver(process)
            print(*driver.home())
            with args.out.open("a") as stream:
                for number, poses in enumerate(random_targets(args.targets, args.seed)):
                    if number < done:
                        continue
                    line = driver.drive(number, poses)
                    stream.write(json.dumps({**line, "roll": args.roll}) + "\n")
                    stream.flush()
                    told = line["refused"]["reason"] if "refused" in line else "reached"
                    print(f"{number}: {line['seconds']:.2f} s, {told}", flush=True)
            begin, processor_s = time.monotonic(), driver.processor_s()
            print(*driver.home())
            clock_s, processor_s = time.monotonic() - begin, driver.processor_s() - processor_s
            print(f"after {clock_s:.2f} s, {processor_s:.2f} s of the processor")
        finally:
            process.terminate()


if __name__ == "__main__":
    main()
