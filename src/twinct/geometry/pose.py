"""Rigid transforms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import ArrayLike

from twinct.geometry.arrays import UNIT_TOLERANCE, Floats, frozen

MM_PER_M = 1000.0


@dataclass(frozen=True, eq=False)
class Pose:
    """Rigid transform; ``world_from_tool`` maps tool coordinates to world coordinates.

    A twist is (v, w) in se(3), as in mink: v in mm, w in rad. A twist on the right is in the tool's
    own axes, ``world_from_tool @ Pose.exp(twist)``; a twist on the left is in the world's axes,
    ``Pose.exp(twist) @ world_from_tool``. ``adjoint`` converts the first into the second.

    Attributes:
        position: origin of the inner frame in the outer one, (3,), mm.
        quat: unit quaternion (x, y, z, w), (4,).
    """

    position: Floats
    quat: Floats

    def __post_init__(self) -> None:
        """Copy, check and freeze the arrays."""
        quat = frozen(self.quat, (4,), "quat")
        if abs(np.linalg.norm(quat) - 1.0) > UNIT_TOLERANCE:
            raise ValueError(f"quat {quat} is not a unit quaternion")
        object.__setattr__(self, "position", frozen(self.position, (3,), "position"))
        object.__setattr__(self, "quat", quat)

    @classmethod
    def identity(cls) -> Pose:
        """Return the identity: outer and inner frame coincide."""
        return cls(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))

    @classmethod
    def from_matrix(cls, position: ArrayLike, rotation: ArrayLike) -> Pose:
        """Build from an origin (3,) in mm and a rotation matrix (3, 3), columns the inner axes."""
        turned = scipy.spatial.transform.Rotation.from_matrix(np.asarray(rotation))
        return cls(np.asarray(position), turned.as_quat())

    @classmethod
    def from_euler(cls, position: ArrayLike, degrees: ArrayLike) -> Pose:
        """Build from an origin in mm and extrinsic x, y, z rotations in degrees."""
        angles = np.asarray(degrees, dtype=np.float64)
        turned = scipy.spatial.transform.Rotation.from_euler("xyz", angles, degrees=True)
        return cls(np.asarray(position), turned.as_quat())

    @classmethod
    def from_metres(cls, position_m: ArrayLike, quat: ArrayLike) -> Pose:
        """Build from the units of MuJoCo and ROS 2: metres, and a quaternion (x, y, z, w)."""
        return cls(np.asarray(position_m, dtype=np.float64) * MM_PER_M, np.asarray(quat))

    @classmethod
    def from_seven(cls, numbers: Sequence[float]) -> Pose:
        """Build from the numbers of a message: metres, and a quaternion (x, y, z, w).

        The pose keeps them: a number times 1000, divided by 1000, may be another number.
        """
        pose = cls.from_metres(numbers[:3], numbers[3:])
        vars(pose)["seven"] = tuple(numbers)
        return pose

    @cached_property
    def seven(self) -> tuple[float, ...]:
        """Numbers of a message: metres, and the quaternion (x, y, z, w)."""
        position_m, quat = self.to_metres()
        return (*position_m.tolist(), *quat.tolist())

    def as_sent(self) -> Pose:
        """Return the pose as the reader of a message has it: through metres and back."""
        return Pose.from_seven(self.seven)

    @classmethod
    def exp(cls, twist: ArrayLike) -> Pose:
        """Return the motion along a twist (v, w), (6,), mm and rad, in a unit of time."""
        v, w = np.split(frozen(twist, (6,), "twist"), 2)
        motion = scipy.spatial.transform.RigidTransform.from_exp_coords(np.concatenate([w, v]))
        return cls(motion.translation, motion.rotation.as_quat())

    def log(self) -> Floats:
        """Return the twist (v, w) whose ``exp`` is this pose, (6,), mm and rad, with |w| <= pi."""
        place = self.position.copy()
        motion = scipy.spatial.transform.RigidTransform.from_components(place, self._turn)
        return np.roll(motion.as_exp_coords(), 3)

    def adjoint(self) -> Floats:
        """Return the matrix (6, 6) that converts twists from the inner to the outer frame."""
        rotation = self.rotation
        matrix = np.zeros((6, 6))
        matrix[:3, :3] = matrix[3:, 3:] = rotation
        matrix[:3, 3:] = np.cross(self.position, rotation.T).T
        return matrix

    def to_euler(self) -> tuple[Floats, Floats]:
        """Return origin in mm and extrinsic x, y, z rotations in degrees, as for ``from_euler``."""
        return self.position, self._turn.as_euler("xyz", degrees=True)

    def to_metres(self) -> tuple[Floats, Floats]:
        """Return the position in metres and the quaternion (x, y, z, w)."""
        return self.position / MM_PER_M, self.quat

    @property
    def _turn(self) -> scipy.spatial.transform.Rotation:
        return scipy.spatial.transform.Rotation.from_quat(self.quat)

    @property
    def rotation(self) -> Floats:
        """Rotation matrix (3, 3); its columns are the inner axes in the outer frame."""
        return self._turn.as_matrix()

    @property
    def matrix(self) -> Floats:
        """Homogeneous matrix (4, 4), mm."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.rotation
        matrix[:3, 3] = self.position
        return matrix

    def __matmul__(self, other: Pose) -> Pose:
        """Compose: ``world_from_tool @ tool_from_source`` is ``world_from_source``."""
        if type(other) is not Pose:
            return NotImplemented
        turned = self._turn * other._turn
        return Pose(self.apply(other.position), turned.as_quat())

    def inverse(self) -> Pose:
        """Return the inverse transform."""
        back = self._turn.inv()
        return Pose(-back.apply(self.position.copy()), back.as_quat())

    def apply(self, points: ArrayLike) -> Floats:
        """Map points (..., 3) from the inner to the outer frame."""
        return np.asarray(points, dtype=np.float64) @ self.rotation.T + self.position

    def rotate(self, vectors: ArrayLike) -> Floats:
        """Rotate vectors (..., 3) from the inner to the outer frame."""
        return np.asarray(vectors, dtype=np.float64) @ self.rotation.T

    def angle_deg(self, other: Pose) -> float:
        """Return the angle of the relative rotation, degrees."""
        relative = self._turn.inv() * other._turn
        return float(np.degrees(relative.magnitude()))

    def distance_mm(self, other: Pose) -> float:
        """Return the distance between the two origins, mm."""
        return float(np.linalg.norm(self.position - other.position))

    def __eq__(self, other: object) -> bool:
        """Compare two poses, to the last bit."""
        return (
            isinstance(other, Pose)
            and np.array_equal(self.position, other.position)
            and np.array_equal(self.quat, other.quat)
        )

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        """Return an expression that evaluates to an equal pose."""
        return f"Pose({self.position.tolist()}, {self.quat.tolist()})"
