"""Standard ROS 2 messages of a scan, made from plain data, and checks of received ones.

Functions that read or check a message raise ``MalformedError`` if its content does not fit its
topic.
"""

from __future__ import annotations

import array
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Any, TypeVar

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Pose, PoseArray
from numpy.typing import NDArray
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, JointState, TimeReference
from std_msgs.msg import Float64MultiArray

from twinct.core.foreign_text import quoted
from twinct.geometry import Pose as CtPose
from twinct.geometry import ScanGeometry
from twinct.geometry.wire import JointSample, PosePairs, Reached
from twinct.link import plain
from twinct.link.plain import Message
from twinct.link.stamps import Stamp
from twinct.link.topics import message_class

M = TypeVar("M")


class MalformedError(ValueError):
    """A message whose content does not fit its topic."""


def ros_message(kind: type[M], fields: Message) -> M:
    """Return a ROS message from plain data; fields that are not given keep their default.

    Arrays of numbers become ``array.array``, which messages accept without checking each number.
    """
    made = kind()
    for name, value in fields.items():
        setattr(made, name, _field(_types(kind)[name], value))
    return made


@cache
def _types(kind: type[Any]) -> dict[str, str]:
    return kind.get_fields_and_field_types()


def _field(kind: str, value: Any) -> Any:
    """Return the value of a field, whose type is text such as ``sequence<double>``."""
    inner = kind.removeprefix("sequence<").removesuffix(">")
    if "/" in inner:
        part = message_class(inner)
        return ros_message(part, value) if kind == inner else [ros_message(part, v) for v in value]
    if kind in _ARRAYS:
        return array.array(_ARRAYS[kind], value)
    return value


_ARRAYS = {"sequence<double>": "d", "sequence<uint8>": "B"}


def numbers_of(pose: Pose) -> tuple[float, ...]:
    """Return position and quaternion (x, y, z, w)."""
    p, q = pose.position, pose.orientation
    return p.x, p.y, p.z, q.x, q.y, q.z, q.w


def _poses(message: PoseArray, names: tuple[str, ...], *, repeated: bool = False) -> PosePairs:
    if message.header.frame_id not in (plain.WORLD, ""):
        raise MalformedError(f"frame {quoted(message.header.frame_id)}, expected {plain.WORLD!r}")
    count = len(message.poses)
    if count != len(names) and not (repeated and count and count % len(names) == 0):
        raise MalformedError(f"{count} poses, expected {len(names)}: {', '.join(names)}")
    poses: list[CtPose] = []
    for i, pose in enumerate(message.poses):
        try:
            poses.append(CtPose.from_seven(numbers_of(pose)))
        except ValueError as error:
            raise MalformedError(f"pose {i}, {names[i % len(names)]}: {error}") from None
    source, *specimen, detector = (tuple(poses[k :: len(names)]) for k in range(len(names)))
    return PosePairs(source, detector, *specimen)


def _check_numbers(values: Sequence[float], what: str, count: int) -> None:
    if len(values) != count:
        raise MalformedError(f"{what} has {len(values)} numbers, expected {count}")
    if not np.isfinite(values).all():
        raise MalformedError(f"{what} holds numbers that are not finite")


def target_message(stamp: Stamp, target: PosePairs) -> PoseArray:
    """Return a ``/scan/target`` message."""
    return ros_message(PoseArray, plain.targets(stamp, [target]))


def target_of(message: PoseArray) -> PosePairs:
    """Return the target from ``/scan/target``: two poses in the world frame."""
    return _poses(message, ("source", "detector"))


def targets_message(stamp: Stamp, targets: Sequence[PosePairs]) -> PoseArray:
    """Return a ``/scan/commanded`` message: source and detector of each view."""
    return ros_message(PoseArray, plain.targets(stamp, targets))


def targets_of(message: PoseArray) -> tuple[PosePairs, ...]:
    """Return the targets from ``/scan/commanded``."""
    poses = _poses(message, ("source", "detector"), repeated=True)
    return tuple(poses[view : view + 1] for view in range(len(poses)))


def parts_of(poses: PosePairs, samples: int) -> tuple[PosePairs, PosePairs | None]:
    """Return the instants of a finite exposure, and the previous view's poses, if any.

    Args:
        poses: all poses of an image, from ``executed_of``.
        samples: the scenario's ``source.motion_samples``.
    """
    expected = samples if samples > 1 else 0
    more, rest = len(poses) - 1, poses[1 + expected :]
    if more < expected or len(rest) > 1:
        raise MalformedError(
            f"{3 + 3 * more} poses, expected {3 + 3 * expected}, or three more with "
            "detector lag: source, object and detector of each instant"
        )
    return poses[1 : 1 + expected], rest or None


def executed(reached: Reached) -> PosePairs:
    """Return all poses that the image of a reached view depends on.

    The first instant is in the middle of the exposure. The instants of a finite exposure follow,
    and, with detector lag, the previous view's poses.
    """
    return PosePairs.joined([reached.executed, reached.exposure, reached.before or PosePairs()])


def reached_message(stamp: Stamp, poses: PosePairs) -> PoseArray:
    """Return a ``/scan/reached`` message of the poses of ``executed``."""
    return ros_message(PoseArray, plain.poses(stamp, [poses]))


def executed_of(message: PoseArray) -> PosePairs:
    """Return the poses from ``/scan/reached``: a multiple of three, in the world frame."""
    return _poses(message, ("source_m", "object_m", "detector_m"), repeated=True)


def view_message(stamp: Stamp, target: Stamp, view: int | None) -> TimeReference:
    """Return a ``/scan/views`` message; see ``plain.view``."""
    return ros_message(TimeReference, plain.view(stamp, target, view))


def joints_message(stamp: Stamp, joints: Reached | JointSample) -> JointState:
    """Return a ``/joint_states`` message."""
    return ros_message(JointState, plain.joints(stamp, joints))


def joints_of(message: JointState) -> JointSample:
    """Return the joint state from a checked ``/joint_states`` message."""
    numbers = (np.array(n) for n in (message.position, message.velocity, message.effort))
    return JointSample(Stamp.of(message.header.stamp).time_s, tuple(message.name), *numbers)


def checked_joints(message: JointState, *, arms: bool = True) -> JointState:
    """Check that each joint has a finite position, speed and torque; return the message.

    A gantry, which is not ``arms``, has no joints.
    """
    if bool(message.name) != arms:
        raise MalformedError(
            "no joints" if arms else f"a gantry has no joints, but got {message.name}"
        )
    for what in ("position", "velocity", "effort"):
        _check_numbers(getattr(message, what), what, len(message.name))
    return message


def state_message(stamp: Stamp, reached: Reached) -> Float64MultiArray:
    """Return a ``/scan/state`` message; see ``plain.state``."""
    return ros_message(Float64MultiArray, plain.state(stamp, reached))


def state_stamp(message: Float64MultiArray) -> Stamp | None:
    """Return the stamp of a ``/scan/state``; None if it has none."""
    try:
        return Stamp.parse(list(message.layout.dim)[0].label)
    except (IndexError, ValueError):
        return None


def checked_state(message: Float64MultiArray, *, arms: bool = True) -> Float64MultiArray:
    """Check that the message has as many finite numbers as its layout states; return it.

    Without ``arms``, the clearance may be NaN.
    """
    size = sum(dim.size for dim in list(message.layout.dim)[:1])
    if not size:
        raise MalformedError("no simulator state")
    numbers = np.array(message.data)
    if not arms:
        numbers[1:2] = 0.0
    _check_numbers(numbers.tolist(), "data", 3 + size)
    return message


def reached_of(
    poses: PosePairs, joints: JointState, state: Float64MultiArray, samples: int = 1
) -> Reached:
    """Return the state of the robots from its three messages, which were checked.

    Args:
        poses: poses from ``/scan/reached``.
        joints: message of ``/joint_states``.
        state: message of ``/scan/state``.
        samples: the scenario's ``source.motion_samples``.
    """
    exposure, before = parts_of(poses, samples)
    time_s, clearance_mm, since_middle_s, *_ = state.data
    return Reached(
        executed=poses[:1],
        joint_names=tuple(joints.name),
        position=np.array(joints.position),
        velocity=np.array(joints.velocity),
        effort=np.array(joints.effort),
        state=np.array(state.data[3:]),
        time_s=time_s,
        clearance_mm=clearance_mm,
        exposure=exposure,
        before=before,
        since_middle_s=since_middle_s,
    )


def clock_message(time_s: float) -> Clock:
    """Return a ``/clock`` message of simulated time."""
    return ros_message(Clock, plain.clock(Stamp.at(time_s)))


def image_message(stamp: Stamp, transmission: NDArray[np.float32]) -> Image:
    """Return an ``/xray/image`` message, row 0 first as in the store."""
    return ros_message(Image, plain.image(stamp, transmission))


def display_message(stamp: Stamp, transmission: NDArray[np.float32]) -> Image:
    """Return an ``/xray/display`` message for viewers; see ``plain.display``."""
    return ros_message(Image, plain.display(stamp, transmission))


def image_of(message: Image, shape: tuple[int, int] | None = None) -> NDArray[np.float32]:
    """Return finite single floats from ``/xray/image``, (rows, columns), of ``shape`` if given."""
    rows, columns = message.height, message.width
    if shape is not None and (rows, columns) != shape:
        raise MalformedError(f"{columns} x {rows} px, expected {shape[1]} x {shape[0]}")
    if message.encoding != plain.FLOATS or message.step != 4 * columns:
        raise MalformedError(
            f"{message.encoding} image with {message.step} bytes per row, "
            f"expected {plain.FLOATS} with {4 * columns}"
        )
    if len(message.data) != 4 * rows * columns:
        raise MalformedError(f"{len(message.data)} bytes, expected {4 * rows * columns}")
    pixels = np.frombuffer(message.data, dtype=">f4" if message.is_bigendian else "<f4")
    if not np.isfinite(pixels).all():
        raise MalformedError(f"{np.count_nonzero(~np.isfinite(pixels))} pixels are not finite")
    return pixels.reshape(rows, columns).astype(np.float32, copy=False)


def camera_message(stamp: Stamp, geometry: ScanGeometry, *, display: bool = False) -> CameraInfo:
    """Return an ``/xray/camera_info`` message; see ``plain.camera``."""
    return ros_message(CameraInfo, plain.camera(stamp, geometry, shown=display))


OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


def diagnostic_message(
    stamp: Stamp, name: str, level: bytes, text: str, values: Mapping[str, object]
) -> DiagnosticArray:
    """Return a ``/diagnostics`` message."""
    fields = plain.diagnostics(stamp, name, text, values)
    fields["status"][0]["level"] = level
    return ros_message(DiagnosticArray, fields)


def diagnostic_values(pairs: Iterable[KeyValue]) -> dict[str, str]:
    """Return the key/value pairs of a status."""
    return {pair.key: pair.value for pair in pairs}
