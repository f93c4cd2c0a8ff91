"""Conversion between data of the simulations and standard ROS 2 messages, number by number.

No number is recomputed, so that both links give bit-identical geometries and images. A target's
``header.stamp`` identifies its view. An answer's stamp is the simulated time in the middle of the
exposure; ``/scan/views`` links the two. ``Float64MultiArray`` has no header:
``layout.dim[0].label`` holds its stamp as ``SECONDS.NANOSECONDS``, with nine digits of nanoseconds.
Functions that read or check a message raise ``MalformedError`` if its content does not fit its
topic.
"""

from __future__ import annotations

import array
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, Pose, PoseArray, Quaternion
from numpy.typing import NDArray
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, JointState, TimeReference
from std_msgs.msg import Float64MultiArray, Header, MultiArrayDimension

from twinct.geometry import ScanGeometry
from twinct.geometry.wire import Instant, JointSample, Reached, SevenNumbers, Target, from_seven
from twinct.scenario import Scenario, stage_digests

WORLD_FRAME = "world"
IMAGE_FRAME = "detector_optical"
"""Frame at the source; x along u, z from the source towards the panel and normal to it."""
IMAGE_ENCODING, DISPLAY_ENCODING = "32FC1", "mono8"
_NANO = 1_000_000_000


class MalformedError(ValueError):
    """A message whose content does not fit its topic."""


class Stamp(NamedTuple):
    """``header.stamp``: the view of a target, or the time of an answer's image."""

    sec: int
    nanosec: int

    @classmethod
    def of(cls, time: Time) -> Stamp:
        """Build from a message's time."""
        return cls(time.sec, time.nanosec)

    @classmethod
    def at(cls, time_s: float) -> Stamp:
        """Build from a simulated time."""
        return cls(*divmod(round(time_s * _NANO), _NANO))

    @classmethod
    def parse(cls, text: str) -> Stamp:
        """Invert ``str``; raise ``ValueError`` unless the text is ``SECONDS.NANOSECONDS``."""
        sec, point, nanosec = text.partition(".")
        if not (point and sec.isdigit() and nanosec.isdigit() and len(nanosec) == 9):
            raise ValueError(f"{text!r} is not SECONDS.NANOSECONDS with nine digits")
        return cls(int(sec), int(nanosec))

    def __str__(self) -> str:
        return f"{self.sec}.{self.nanosec:09d}"

    @property
    def time_s(self) -> float:
        """Time in s."""
        return (self.sec * _NANO + self.nanosec) / _NANO

    @property
    def time(self) -> Time:
        """Time as a message."""
        return Time(sec=self.sec, nanosec=self.nanosec)


@dataclass(frozen=True)
class Epoch:
    """Origin of a scan's target stamps: the stamp of view i is i seconds after the epoch.

    It depends on the scenario alone, so that it stays the same when a scan is resumed.
    """

    stamp: Stamp
    """Stamp of view 0."""

    @classmethod
    def of(cls, scenario: Scenario) -> Epoch:
        """Return the epoch of a scenario's scan."""
        digest = stage_digests(scenario)["images"]
        sec, nanosec = (int(part, 16) % _NANO for part in (digest[:15], digest[15:30]))
        return cls(Stamp(_NANO + sec, nanosec))

    @classmethod
    def parse(cls, text: str) -> Epoch:
        """Invert ``str``."""
        return cls(Stamp.parse(text))

    def __str__(self) -> str:
        return str(self.stamp)

    def at(self, view: int) -> Stamp:
        """Return the stamp of a view."""
        return Stamp(self.stamp.sec + view, self.stamp.nanosec)

    def view(self, stamp: Stamp) -> int | None:
        """Return the view of a stamp; None for a stamp of another epoch."""
        view = stamp.sec - self.stamp.sec
        return view if stamp.nanosec == self.stamp.nanosec and view >= 0 else None


def _header(stamp: Stamp, frame: str = WORLD_FRAME) -> Header:
    return Header(stamp=stamp.time, frame_id=frame)


def _pose(numbers: SevenNumbers) -> Pose:
    x, y, z, qx, qy, qz, qw = numbers
    return Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))


def numbers_of(pose: Pose) -> SevenNumbers:
    """Return position and quaternion (x, y, z, w)."""
    p, q = pose.position, pose.orientation
    return p.x, p.y, p.z, q.x, q.y, q.z, q.w


def _poses(
    message: PoseArray, names: tuple[str, ...], *, repeated: bool = False
) -> tuple[SevenNumbers, ...]:
    if message.header.frame_id not in (WORLD_FRAME, ""):
        raise MalformedError(f"frame {message.header.frame_id!r}, expected {WORLD_FRAME!r}")
    count = len(message.poses)
    if count != len(names) and not (repeated and count and count % len(names) == 0):
        raise MalformedError(f"{count} poses, expected {len(names)}: {', '.join(names)}")
    poses = tuple(map(numbers_of, message.poses))
    for i, numbers in enumerate(poses):
        try:
            from_seven(numbers)
        except ValueError as error:
            raise MalformedError(f"pose {i}, {names[i % len(names)]}: {error}") from None
    return poses


def _check_numbers(values: Sequence[float], what: str, count: int) -> None:
    if len(values) != count:
        raise MalformedError(f"{what} has {len(values)} numbers, expected {count}")
    if not np.isfinite(values).all():
        raise MalformedError(f"{what} holds numbers that are not finite")


def target_message(stamp: Stamp, target: Target) -> PoseArray:
    """Return a ``/scan/target`` message."""
    poses = [_pose(target.source_m), _pose(target.detector_m)]
    return PoseArray(header=_header(stamp, WORLD_FRAME), poses=poses)


def target_of(message: PoseArray) -> Target:
    """Return the target from ``/scan/target``: two poses in the world frame."""
    return Target(*_poses(message, ("source", "detector")))


def targets_message(stamp: Stamp, targets: Sequence[Target]) -> PoseArray:
    """Return a ``/scan/commanded`` message: source and detector of each view."""
    poses = [_pose(numbers) for t in targets for numbers in (t.source_m, t.detector_m)]
    return PoseArray(header=_header(stamp, WORLD_FRAME), poses=poses)


def targets_of(message: PoseArray) -> tuple[Target, ...]:
    """Return the targets from ``/scan/commanded``."""
    poses = _poses(message, ("source", "detector"), repeated=True)
    return tuple(Target(*pair) for pair in zip(poses[::2], poses[1::2], strict=True))


class Executed(NamedTuple):
    """Content of ``/scan/reached``: all poses that an image depends on.

    Attributes:
        view: executed poses in the middle of the exposure.
        more: instants of a finite exposure, followed, with detector lag, by the previous view's
            poses.
    """

    view: Instant
    more: tuple[Instant, ...] = ()

    def exposure(self, samples: int) -> tuple[tuple[Instant, ...], Instant | None]:
        """Return the instants of a finite exposure, and the previous view's poses, if any.

        Args:
            samples: the scenario's ``source.motion_samples``.
        """
        expected = samples if samples > 1 else 0
        rest = self.more[expected:]
        if len(self.more) < expected or len(rest) > 1:
            raise MalformedError(
                f"{3 + 3 * len(self.more)} poses, expected {3 + 3 * expected}, or three more with "
                "detector lag: source, object and detector of each instant"
            )
        return self.more[:expected], rest[0] if rest else None


def executed(reached: Reached) -> Executed:
    """Return the poses of a reached view."""
    before = () if reached.before is None else (reached.before,)
    return Executed(reached.executed, (*reached.exposure, *before))


def reached_message(stamp: Stamp, poses: Executed) -> PoseArray:
    """Return a ``/scan/reached`` message."""
    numbers = [pose for instant in (poses.view, *poses.more) for pose in instant]
    return PoseArray(header=_header(stamp, WORLD_FRAME), poses=[_pose(pose) for pose in numbers])


def executed_of(message: PoseArray) -> Executed:
    """Return the poses from ``/scan/reached``: a multiple of three, in the world frame."""
    poses = _poses(message, Instant._fields, repeated=True)
    view, *more = (Instant(*poses[i : i + 3]) for i in range(0, len(poses), 3))
    return Executed(view, tuple(more))


def view_message(stamp: Stamp, target: Stamp, view: int | None) -> TimeReference:
    """Return a ``/scan/views`` message, which links answers to a target.

    Args:
        stamp: the answers' stamp.
        target: the target's stamp.
        view: index of the view in a scan, if any.
    """
    source = "target" if view is None else f"view {view}"
    return TimeReference(header=_header(stamp, ""), time_ref=target.time, source=source)


def joints_message(stamp: Stamp, joints: Reached | JointSample) -> JointState:
    """Return a ``/joint_states`` message."""
    return JointState(
        header=_header(stamp, WORLD_FRAME),
        name=list(joints.joint_names),
        position=doubles(joints.position),
        velocity=doubles(joints.velocity),
        effort=doubles(joints.effort),
    )


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
    """Return the ``/scan/state`` message: three scalars, then the simulator's state.

    The scalars are the simulated time in s, the clearance in mm, and the seconds since the middle
    of the exposure.
    """
    few = reached.time_s, reached.clearance_mm, reached.since_middle_s
    numbers = np.concatenate([few, reached.state])
    message = Float64MultiArray(data=doubles(numbers))
    size = len(reached.state)
    message.layout.data_offset = len(few)
    message.layout.dim = [MultiArrayDimension(label=str(stamp), size=size, stride=size)]
    return message


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
    poses: Executed, joints: JointState, state: Float64MultiArray, samples: int = 1
) -> Reached:
    """Return the state of the robots from its three messages, which were checked.

    Args:
        poses: poses from ``/scan/reached``.
        joints: message of ``/joint_states``.
        state: message of ``/scan/state``.
        samples: the scenario's ``source.motion_samples``.
    """
    exposure, before = poses.exposure(samples)
    time_s, clearance_mm, since_middle_s, *_ = state.data
    return Reached(
        executed=poses.view,
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


def doubles(values: NDArray[np.float64]) -> array.array[float]:
    """Return an array that messages accept without checking each number."""
    return array.array("d", np.ascontiguousarray(values, dtype=np.float64).tobytes())


def clock_message(time_s: float) -> Clock:
    """Return a ``/clock`` message of simulated time."""
    return Clock(clock=Stamp.at(time_s).time)


def image_message(stamp: Stamp, transmission: NDArray[np.float32]) -> Image:
    """Return the ``/xray/image`` message, row 0 first as in the store."""
    rows, columns = transmission.shape
    message = Image(header=_header(stamp, IMAGE_FRAME), encoding=IMAGE_ENCODING)
    message.height, message.width, message.step = rows, columns, 4 * columns
    # Messages accept an array of bytes as is, but check any other sequence byte by byte.
    message.data = array.array("B", np.ascontiguousarray(transmission, dtype="<f4").tobytes())
    return message


def display_message(stamp: Stamp, transmission: NDArray[np.float32]) -> Image:
    """Return the ``/xray/display`` message for viewers: row 0 on top, where v is largest.

    Black is a transmission of 0, white a transmission of 1 and above.
    """
    grey = np.rint(255 * np.clip(transmission[::-1], 0, 1)).astype(np.uint8)
    rows, columns = grey.shape
    message = Image(header=_header(stamp, IMAGE_FRAME), encoding=DISPLAY_ENCODING)
    message.height, message.width, message.step = rows, columns, columns
    message.data = array.array("B", grey.tobytes())
    return message


def image_of(message: Image, shape: tuple[int, int] | None = None) -> NDArray[np.float32]:
    """Return finite single floats from ``/xray/image``, (rows, columns), of ``shape`` if given."""
    rows, columns = message.height, message.width
    if shape is not None and (rows, columns) != shape:
        raise MalformedError(f"{columns} x {rows} px, expected {shape[1]} x {shape[0]}")
    if message.encoding != IMAGE_ENCODING or message.step != 4 * columns:
        raise MalformedError(
            f"{message.encoding} image with {message.step} bytes per row, "
            f"expected {IMAGE_ENCODING} with {4 * columns}"
        )
    if len(message.data) != 4 * rows * columns:
        raise MalformedError(f"{len(message.data)} bytes, expected {4 * rows * columns}")
    pixels = np.frombuffer(message.data, dtype=">f4" if message.is_bigendian else "<f4")
    if not np.isfinite(pixels).all():
        raise MalformedError(f"{np.count_nonzero(~np.isfinite(pixels))} pixels are not finite")
    return pixels.reshape(rows, columns).astype(np.float32, copy=False)


def camera_message(stamp: Stamp, geometry: ScanGeometry, *, display: bool = False) -> CameraInfo:
    """Return the ``/xray/camera_info`` message: source and panel of one view as a pinhole camera.

    A point (x, y, z) of the frame ``detector_optical`` falls on column fx x/z + cx and row
    fy y/z + cy; pixel centres are whole numbers. Rows count along v, which is -y, so fy is
    negative. With ``display``, they count downwards, so fy is positive.
    """
    panel = geometry.panel
    sdd = float(geometry.sdd[0])
    fx, fy = sdd / panel.pitch_u, -sdd / panel.pitch_v
    cx, cy = geometry.piercing_points[0].tolist()
    if display:
        fy, cy = -fy, panel.rows - 1 - cy
    message = CameraInfo(header=_header(stamp, IMAGE_FRAME), height=panel.rows, width=panel.columns)
    message.distortion_model = "plumb_bob"
    message.d = [0.0] * 5
    message.k = [fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
    message.r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    message.p = [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    return message


OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


def diagnostic_message(
    stamp: Stamp, name: str, level: bytes, text: str, values: Mapping[str, object]
) -> DiagnosticArray:
    """Return a ``/diagnostics`` message."""
    pairs = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
    status = DiagnosticStatus(level=level, name=name, message=text, values=pairs)
    return DiagnosticArray(header=_header(stamp, WORLD_FRAME), status=[status])


def diagnostic_values(pairs: Iterable[KeyValue]) -> dict[str, str]:
    """Return the key/value pairs of a status."""
    return {pair.key: pair.value for pair in pairs}
