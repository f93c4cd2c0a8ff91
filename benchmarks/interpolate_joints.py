"""How well another program knows the poses of a scan from joints and robot description alone.

    python benchmarks/interpolate_joints.py                                # on entry, moving
    python benchmarks/interpolate_joints.py --set motion.trigger=settled
    python benchmarks/interpolate_joints.py --set source.motion_samples=5  # 10 ms exposures

``twinct run`` scans over ROS 2. Meanwhile this client hears ``/joint_states``, the description and
``/xray/image``, leaves out the joints at the images' own stamps, interpolates the others there
(cubic Hermite, with their velocities), and looks with ``yourdfpy`` where source and panel were.
That is compared with ``/scan/reached``. It knows standard messages only; nothing of twinct is
imported. After the last view nothing moves any more: there the last two joints are extrapolated.
"""

from __future__ import annotations

import argparse
import io
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from geometry_msgs.msg import Pose, PoseArray
from rclpy.qos import DurabilityPolicy, QoSProfile
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import String
from yourdfpy import URDF

LARGEST_MM = 0.05
HEARD = {
    "/joint_states": JointState,
    "/scan/reached": PoseArray,
    "/xray/image": Image,
    "/robot_description": String,
}
QUICK = (
    *("detector.columns=32", "detector.rows=24", "detector.pixel_pitch_mm=10"),
    "specimen.parts=[{shape: {kind: sphere, radius_mm: 60}, material: bone}]",
    *("reconstruction.grid.voxels=16", "reconstruction.grid.voxel_mm=10"),
    "reconstruction.iterations=1",
)
"""Few pixels and voxels: poses do not depend on them."""


def nanoseconds(message: Any) -> int:
    return message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec


def heard_of(scenario: str, sets: list[str], domain: int) -> dict[str, list[Any]]:
    """All messages of a scan."""
    os.environ.update(ROS_DOMAIN_ID=str(domain), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    rclpy.init()
    node = rclpy.create_node("listener")
    heard: dict[str, list[Any]] = {topic: [] for topic in HEARD}
    qos = QoSProfile(depth=5000, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    for topic, kind in HEARD.items():
        node.create_subscription(kind, topic, heard[topic].append, qos)
    options = [part for key in (*QUICK, *sets) for part in ("--set", key)]
    with tempfile.TemporaryDirectory() as out:
        command = [sys.executable, "-m", "twinct", "run", scenario, "--out", f"{out}/run", *options]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
            while process.poll() is None:
                rclpy.spin_once(node, timeout_sec=0.1)
    if process.returncode:
        raise SystemExit(f"the scan ended with exit code {process.returncode}")
    node.destroy_node()
    rclpy.shutdown()
    return heard


def offsets_mm(heard: dict[str, list[Any]]) -> np.ndarray:
    """How far off source and detector are at each image, mm, (views, 2); and degrees, beside."""
    stamps = [nanoseconds(image) for image in heard["/xray/image"]]
    joints = {nanoseconds(m): m for m in heard["/joint_states"]}
    kept = [joints[time] for time in sorted(joints.keys() - set(stamps))]
    times_s = [1e-9 * nanoseconds(m) for m in kept]
    way = CubicHermiteSpline(times_s, [m.position for m in kept], [m.velocity for m in kept])
    [description] = heard["/robot_description"]
    urdf = URDF.load(io.StringIO(description.data), load_meshes=False)
    reached = {nanoseconds(m): m.poses for m in heard["/scan/reached"]}
    off = []
    for stamp in stamps:
        urdf.update_cfg(dict(zip(kept[0].name, way(1e-9 * stamp), strict=True)))
        source, _, detector, *_ = reached[stamp]
        pairs = ((source, "source"), (detector, "detector"))
        off.append([apart(pose, urdf.get_transform(frame)) for pose, frame in pairs])
    return np.array(off)


def apart(pose: Pose, found: np.ndarray) -> tuple[float, float]:
    """Distance, mm, and angle, degrees."""
    p, q = pose.position, pose.orientation
    turn = Rotation.from_quat([q.x, q.y, q.z, q.w]).inv() * Rotation.from_matrix(found[:3, :3])
    distance_m = np.linalg.norm(found[:3, 3] - [p.x, p.y, p.z])
    return 1000 * float(distance_m), float(np.degrees(turn.magnitude()))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--scenario", type=Path, default=Path("scenarios/demo.yaml"))
    parser.add_argument("--set", dest="sets", action="append", default=[], metavar="KEY=VALUE")
    parser.add_argument("--domain", type=int, default=87)
    options = parser.parse_args()
    heard = heard_of(str(options.scenario), options.sets, options.domain)
    off = offsets_mm(heard)
    views, told = len(off), len(heard["/joint_states"])
    print(f"{views} views, {told} messages of joints")
    for name, part in (("all but the last view", off[:-1]), ("the last view", off[-1:])):
        mm, degrees = part[..., 0].max(axis=0), part[..., 1].max(axis=0)
        print(f"{name}: source {mm[0]:.4f} mm, {degrees[0]:.5f} deg; ", end="")
        print(f"detector {mm[1]:.4f} mm, {degrees[1]:.5f} deg at most")
    if off[..., 0].max() > LARGEST_MM:
        raise SystemExit(f"more than {LARGEST_MM} mm")


if __name__ == "__main__":
    main()
