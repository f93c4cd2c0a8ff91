"""Messages of the ROS 2 link as plain data, for recordings of the local link without ROS."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import ScanGeometry
from twinct.geometry.wire import Instant, JointSample, Reached, SevenNumbers, Target
from twinct.scenario import Scenario, stage_digests

if TYPE_CHECKING:
    from twinct.robots.motion import MotionPlan

Message = dict[str, Any]

NANO = 1_000_000_000
WORLD = "world"
OPTICAL = "detector_optical"


def nanoseconds(time_s: float) -> int:
    """Convert a time to whole nanoseconds, as used in messages."""
    return round(time_s * NANO)


def epoch_ns(scenario: Scenario) -> int:
    """Return the stamp of view 0's target, ns; each further view adds one second."""
    digest = stage_digests(scenario)["images"]
    sec, nanosec = (int(part, 16) % NANO for part in (digest[:15], digest[15:30]))
    return (NANO + sec) * NANO + nanosec


def time_of(ns: int) -> Message:
    """Return a ``builtin_interfaces/msg/Time``."""
    sec, nanosec = divmod(ns, NANO)
    return {"sec": sec, "nanosec": nanosec}


def header(ns: int, frame: str = WORLD) -> Message:
    """Return a ``std_msgs/msg/Header``."""
    return {"stamp": time_of(ns), "frame_id": frame}


def poses(ns: int, numbers: Iterable[SevenNumbers]) -> Message:
    """Return a ``geometry_msgs/msg/PoseArray``, for targets and executed poses."""
    both = [(dict(zip("xyz", n[:3], strict=True)), _quat(n)) for n in numbers]
    parts = [{"position": position, "orientation": quat} for position, quat in both]
    return {"header": header(ns), "poses": parts}


def _quat(numbers: Sequence[float]) -> Message:
    return dict(zip("xyzw", numbers[3:], strict=True))


def targets(ns: int, asked: Sequence[Target]) -> Message:
    """Return source and detector of one view, or all."""
    return poses(ns, (n for target in asked for n in (target.source_m, target.detector_m)))


def reached(ns: int, got: Reached) -> Message:
    """Return source, object and detector at the view's instant, and all others of the image."""
    before = () if got.before is None else (got.before,)
    return poses(ns, (n for instant in (got.executed, *got.exposure, *before) for n in instant))


def transforms(
    ns: int, instant: Instant, links: Mapping[str, Sequence[float]] | None = None
) -> Message:
    """Return a ``tf2_msgs/msg/TFMessage``: frames of source, specimen, panel, camera and links.

    The camera's axes are u, -v and, from source to panel, -(u x v): half a turn about u.
    """
    x, y, z, w = instant.detector_m[3:]
    frames = {
        **(links or {}),
        "source": instant.source_m,
        "specimen": instant.object_m,
        "detector": instant.detector_m,
        OPTICAL: (*instant.source_m[:3], w, z, -y, -x),
    }
    return {
        "transforms": [
            {
                "header": header(ns),
                "child_frame_id": name,
                "transform": {
                    "translation": dict(zip("xyz", numbers[:3], strict=True)),
                    "rotation": _quat(numbers),
                },
            }
            for name, numbers in frames.items()
        ]
    }


def view(ns: int, target_ns: int, number: int) -> Message:
    """Return a ``sensor_msgs/msg/TimeReference``, which links the stamp of answers to a target."""
    return {"header": header(ns, ""), "time_ref": time_of(target_ns), "source": f"view {number}"}


def joints(ns: int, at: Reached | JointSample) -> Message:
    """Return a ``sensor_msgs/msg/JointState``."""
    numbers = {name: getattr(at, name).tolist() for name in ("position", "velocity", "effort")}
    return {"header": header(ns), "name": list(at.joint_names), **numbers}


def state(ns: int, got: Reached) -> Message:
    """Return a ``std_msgs/msg/Float64MultiArray``; docs/ros.md lists its numbers."""
    few = got.time_s, got.clearance_mm, got.since_middle_s
    label, size = "{}.{:09d}".format(*divmod(ns, NANO)), len(got.state)
    layout = {"dim": [{"label": label, "size": size, "stride": size}], "data_offset": len(few)}
    return {"layout": layout, "data": [*few, *got.state.tolist()]}


def image(ns: int, pixels: NDArray[np.float32]) -> Message:
    """Return a ``sensor_msgs/msg/Image``, row 0 first as in the store."""
    return _image(ns, "32FC1", np.ascontiguousarray(pixels, "<f4"))


def display(ns: int, pixels: NDArray[np.float32]) -> Message:
    """Return the image for viewers: row 0 on top (largest v), black 0, white 1 and above."""
    grey = np.rint(255 * np.clip(pixels[::-1], 0, 1)).astype(np.uint8)
    return _image(ns, "mono8", grey)


def _image(ns: int, encoding: str, pixels: NDArray[np.generic]) -> Message:
    rows, columns = pixels.shape
    return {
        "header": header(ns, OPTICAL),
        "height": rows,
        "width": columns,
        "encoding": encoding,
        "step": pixels.itemsize * columns,
        "data": pixels.tobytes(),
    }


def camera(ns: int, geometry: ScanGeometry, *, shown: bool = False) -> Message:
    """Return a ``sensor_msgs/msg/CameraInfo`` of a single view; docs/ros.md defines the frame.

    ``shown``: for the image that viewers show, whose rows count downwards.
    """
    panel, sdd = geometry.panel, float(geometry.sdd[0])
    fx, fy = sdd / panel.pitch_u, -sdd / panel.pitch_v
    cx, cy = geometry.piercing_points[0].tolist()
    if shown:
        fy, cy = -fy, panel.rows - 1 - cy
    return {
        "header": header(ns, OPTICAL),
        "height": panel.rows,
        "width": panel.columns,
        "distortion_model": "plumb_bob",
        "d": [0.0] * 5,
        "k": [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        "r": np.eye(3).ravel().tolist(),
        "p": [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    }


def trajectory(ns: int, plan: MotionPlan) -> Message:
    """Return the motion plan as a ``trajectory_msgs/msg/JointTrajectory``."""
    points = [
        {
            "positions": position,
            "velocities": velocity,
            "accelerations": acceleration,
            "time_from_start": time_of(since),
        }
        for since, (position, velocity, acceleration) in zip(
            map(nanoseconds, plan.time_s.tolist()), plan.state.tolist(), strict=True
        )
    ]
    return {"header": header(ns), "joint_names": list(plan.joint_names), "points": points}


def plan_views(ns: int, plan: MotionPlan) -> Message:
    """Return a ``diagnostic_msgs/msg/DiagnosticArray``: a plan's digest, and each view's point."""
    values = {"digest": plan.digest, "points": " ".join(map(str, plan.waypoints.tolist()))}
    pairs = [{"key": key, "value": value} for key, value in values.items()]
    text = "the point that exposes each view"
    status = {"name": "twinct_scan", "message": text, "values": pairs}
    return {"header": header(ns), "status": [status]}
