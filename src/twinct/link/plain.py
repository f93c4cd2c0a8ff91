"""Messages of a scan as plain data, for both links and for recordings, without ROS.

No number is recomputed, so that both links give bit-identical geometries and images. A target's
``header.stamp`` identifies its view. An answer's stamp is the simulated time in the middle of the
exposure; ``/scan/views`` links the two. ``Float64MultiArray`` has no header:
``layout.dim[0].label`` holds its stamp as ``SECONDS.NANOSECONDS``, with nine digits of nanoseconds.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from twinct.geometry import ScanGeometry
from twinct.geometry.wire import JointSample, PosePairs, Reached
from twinct.link.stamps import Stamp

if TYPE_CHECKING:
    from twinct.robots.motion import MotionPlan

Message = dict[str, Any]

WORLD = "world"
OPTICAL = "detector_optical"
"""Frame at the source; x along u, z from the source towards the panel and normal to it."""
FLOATS, GREY = "32FC1", "mono8"
"""Encodings of images, and of images for viewers."""


def header(stamp: Stamp, frame: str = WORLD) -> Message:
    """Return a ``std_msgs/msg/Header``."""
    return {"stamp": stamp._asdict(), "frame_id": frame}


def poses(stamp: Stamp, instants: Iterable[PosePairs]) -> Message:
    """Return a ``geometry_msgs/msg/PoseArray``, for targets and executed poses."""
    numbers = (seven for poses in instants for at in poses.sevens for seven in at)
    both = [(dict(zip("xyz", n[:3], strict=True)), _quat(n)) for n in numbers]
    parts = [{"position": position, "orientation": quat} for position, quat in both]
    return {"header": header(stamp), "poses": parts}


def _quat(numbers: Sequence[float]) -> Message:
    return dict(zip("xyzw", numbers[3:], strict=True))


def targets(stamp: Stamp, commanded: Sequence[PosePairs]) -> Message:
    """Return source and detector of one view, or all."""
    return poses(stamp, commanded)


def reached(stamp: Stamp, got: Reached) -> Message:
    """Return source, object and detector at the view's instant, and all others of the image."""
    return poses(stamp, [got.executed, got.exposure, got.before or PosePairs()])


def transforms(
    stamp: Stamp, instant: PosePairs | None, links: Mapping[str, Sequence[float]] | None = None
) -> Message:
    """Return a ``tf2_msgs/msg/TFMessage``: frames of links, and of an instant, if one is given.

    These are source, specimen, panel and camera.

    The camera's axes are u, -v and, from source to panel, -(u x v): half a turn about u.
    """
    frames = dict(links or {})
    if instant is not None:
        ((source, specimen, detector),) = instant.sevens
        x, y, z, w = detector[3:]
        frames |= {
            "source": source,
            "specimen": specimen,
            "detector": detector,
            OPTICAL: (*source[:3], w, z, -y, -x),
        }
    return {
        "transforms": [
            {
                "header": header(stamp),
                "child_frame_id": name,
                "transform": {
                    "translation": dict(zip("xyz", numbers[:3], strict=True)),
                    "rotation": _quat(numbers),
                },
            }
            for name, numbers in frames.items()
        ]
    }


def view(stamp: Stamp, target: Stamp, number: int | None) -> Message:
    """Return a ``sensor_msgs/msg/TimeReference``, which links answers to a target.

    Args:
        stamp: the answers' stamp.
        target: the target's stamp.
        number: index of the view in a scan, if any.
    """
    source = "target" if number is None else f"view {number}"
    return {"header": header(stamp, ""), "time_ref": target._asdict(), "source": source}


def joints(stamp: Stamp, at: Reached | JointSample) -> Message:
    """Return a ``sensor_msgs/msg/JointState``."""
    numbers = {name: getattr(at, name).tolist() for name in ("position", "velocity", "effort")}
    return {"header": header(stamp), "name": list(at.joint_names), **numbers}


def state(stamp: Stamp, got: Reached) -> Message:
    """Return a ``std_msgs/msg/Float64MultiArray``: three scalars, then the simulator's state.

    The scalars are the simulated time in s, the clearance in mm, and the seconds since the middle
    of the exposure.
    """
    few = got.time_s, got.clearance_mm, got.since_middle_s
    size = len(got.state)
    layout = {"dim": [{"label": str(stamp), "size": size, "stride": size}], "data_offset": len(few)}
    return {"layout": layout, "data": [*few, *got.state.tolist()]}


def image(stamp: Stamp, pixels: NDArray[np.float32]) -> Message:
    """Return a ``sensor_msgs/msg/Image``, row 0 first as in the store."""
    return _image(stamp, FLOATS, np.ascontiguousarray(pixels, "<f4"))


def display(stamp: Stamp, pixels: NDArray[np.float32]) -> Message:
    """Return the image for viewers: row 0 on top (largest v), black 0, white 1 and above."""
    grey = np.rint(255 * np.clip(pixels[::-1], 0, 1)).astype(np.uint8)
    return _image(stamp, GREY, grey)


def _image(stamp: Stamp, encoding: str, pixels: NDArray[np.generic]) -> Message:
    rows, columns = pixels.shape
    return {
        "header": header(stamp, OPTICAL),
        "height": rows,
        "width": columns,
        "encoding": encoding,
        "step": pixels.itemsize * columns,
        "data": pixels.tobytes(),
    }


def camera(stamp: Stamp, geometry: ScanGeometry, *, shown: bool = False) -> Message:
    """Return a ``sensor_msgs/msg/CameraInfo``: source and panel of one view as a pinhole camera.

    A point (x, y, z) of the frame ``detector_optical`` falls on column fx x/z + cx and row
    fy y/z + cy; pixel centres are whole numbers. Rows count along v, which is -y, so fy is
    negative. In the image for viewers (``shown``), they count downwards, so fy is positive.
    """
    panel, sdd = geometry.panel, float(geometry.sdd[0])
    fx, fy = sdd / panel.pitch_u, -sdd / panel.pitch_v
    cx, cy = geometry.piercing_points[0].tolist()
    if shown:
        fy, cy = -fy, panel.rows - 1 - cy
    return {
        "header": header(stamp, OPTICAL),
        "height": panel.rows,
        "width": panel.columns,
        "distortion_model": "plumb_bob",
        "d": [0.0] * 5,
        "k": [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        "r": np.eye(3).ravel().tolist(),
        "p": [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    }


def trajectory(stamp: Stamp, plan: MotionPlan) -> Message:
    """Return the motion plan as a ``trajectory_msgs/msg/JointTrajectory``."""
    points = [
        {
            "positions": position,
            "velocities": velocity,
            "accelerations": acceleration,
            "time_from_start": Stamp.at(since)._asdict(),
        }
        for since, (position, velocity, acceleration) in zip(
            plan.time_s.tolist(), plan.state.tolist(), strict=True
        )
    ]
    return {"header": header(stamp), "joint_names": list(plan.joint_names), "points": points}


def plan_views(stamp: Stamp, plan: MotionPlan) -> Message:
    """Return a ``diagnostic_msgs/msg/DiagnosticArray``: a plan's digest, and each view's point."""
    values = {"digest": plan.digest, "points": " ".join(map(str, plan.waypoints.tolist()))}
    return diagnostics(stamp, "twinct_scan", "the point that exposes each view", values)


def diagnostics(stamp: Stamp, name: str, text: str, values: Mapping[str, object]) -> Message:
    """Return a ``diagnostic_msgs/msg/DiagnosticArray`` of one status, with the level OK."""
    pairs = [{"key": key, "value": str(value)} for key, value in values.items()]
    return {"header": header(stamp), "status": [{"name": name, "message": text, "values": pairs}]}


def clock(stamp: Stamp) -> Message:
    """Return a ``rosgraph_msgs/msg/Clock`` of simulated time."""
    return {"clock": stamp._asdict()}
