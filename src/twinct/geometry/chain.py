"""Serial arm: forward kinematics of many joint configurations, and of many similar arms."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
import scipy

from twinct.geometry.arrays import Floats, lock
from twinct.geometry.pose import MM_PER_M

GRAVITY_M_S2 = np.array([0.0, 0.0, -9.81])
N_M_PER_N_MM = 1e-3


def exp_matrices(twists: Floats) -> Floats:
    """Return ``Pose.exp`` of many twists (v, w), (..., 6), mm and rad, as matrices (..., 4, 4)."""
    flat = np.roll(twists.reshape(-1, 6), 3, axis=1)
    moved = scipy.spatial.transform.RigidTransform.from_exp_coords(flat)
    return moved.as_matrix().reshape(*twists.shape[:-1], 4, 4)


@dataclass(frozen=True, eq=False)
class Misfit:
    """Deviation of arms from a chain; leading axes match the joint angles.

    Each twist (v, w), mm and rad, moves everything after its frame, in the frame's own axes. The
    twist of a joint precedes its rotation; its last component adds to the joint angle.

    Attributes:
        base: twist of the base frame, (..., 6).
        links: twists of the joint frames, (..., joints, 6).
        tool: twist of the tool frame, (..., 6).
        joints: deviations of the joints behind their encoders, each (..., joints), rad.
    """

    base: Floats | None = None
    links: Floats | None = None
    tool: Floats | None = None
    joints: tuple[Floats, ...] = ()

    def __bool__(self) -> bool:
        """Return True if any part deviates."""
        return bool(self.joints) or any(
            part is not None for part in (self.base, self.links, self.tool)
        )


@dataclass(frozen=True, eq=False)
class Chain:
    """Serial arm; all frames are in the world, with the joints at zero.

    Every joint is a hinge, except rails, which slide: the unit of these is m instead of rad, and N
    instead of N m.

    Attributes:
        base: ``world_from_base``, (4, 4), mm.
        joints: ``world_from_joint``, the z axis along hinge or rail, (joints, 4, 4), mm.
        tool: ``world_from_tool``, (4, 4), mm.
        masses: mass between each joint and the next, with the tool at the end, kg, (joints,).
        centres: centres of these masses in the world, (joints, 3), mm.
        torque_limits: published limits, N m, (joints,).
        rails: indices of the joints that slide.
    """

    base: Floats
    joints: Floats
    tool: Floats
    masses: Floats
    centres: Floats
    torque_limits: Floats
    rails: tuple[int, ...] = ()
    _steps: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Lock the arrays, and compute the steps from joint to joint and to the tool."""
        before = np.concatenate([np.eye(4)[None], self.joints])
        after = np.concatenate([self.joints, self.tool[None]])
        object.__setattr__(self, "_steps", np.linalg.solve(before, after))
        lock(self, "base", "joints", "tool", "masses", "centres", "torque_limits", "_steps")

    def __len__(self) -> int:
        """Return the number of joints."""
        return len(self.joints)

    @property
    def hinges(self) -> Floats:
        """1 for each hinge, 0 for each rail, (joints,)."""
        flags = np.ones(len(self))
        flags[list(self.rails)] = 0.0
        return flags

    def moves(self, joints: Floats) -> Floats:
        """Return the twist of each joint in its own frame, (..., joints, 6), mm and rad.

        Args:
            joints: rad and m, (..., joints).
        """
        twists = np.zeros((*joints.shape, 6))
        twists[..., 5] = self.hinges * joints
        twists[..., 2] = (1 - self.hinges) * MM_PER_M * joints
        return twists

    def tools(self, joints: Floats, *misfits: Misfit) -> Floats:
        """Return ``world_from_tool`` of many joint configurations.

        Args:
            joints: encoder readings, rad, (..., joints).
            misfits: deviations of the arms, which add up in their order.

        Returns:
            (..., 4, 4), mm.
        """
        return self._walk(joints, misfits)[-1]

    def frames(self, joints: Floats) -> Floats:
        """Return ``world_from_joint`` of each joint after its rotation, then ``world_from_tool``.

        Args:
            joints: rad, (..., joints).

        Returns:
            (..., joints + 1, 4, 4), mm.
        """
        return np.stack(self._walk(joints, keep=True), axis=-3)

    def _walk(
        self, joints: Floats, misfits: tuple[Misfit, ...] = (), keep: bool = False
    ) -> list[Floats]:
        here: Floats = np.eye(4)
        transforms: list[Floats] = []
        links = tool = None
        if misfits:
            base = exp_matrices(_sum((misfit.base for misfit in misfits), (6,)))
            here = self.base @ base @ np.linalg.inv(self.base)
            links = exp_matrices(_sum((misfit.links for misfit in misfits), (len(self), 6)))
            tool = exp_matrices(_sum((misfit.tool for misfit in misfits), (6,)))
            if behind := [turn for misfit in misfits for turn in misfit.joints]:
                joints = joints + sum(behind[1:], behind[0])
        for joint in range(len(self)):
            here = here @ self._steps[joint]
            if links is not None:
                here = here @ links[..., joint, :, :]
            moved = _slid if joint in self.rails else _turned
            here = moved(here, joints[..., joint])
            transforms += [here] if keep else []
        here = here @ self._steps[-1]
        if tool is not None:
            here = here @ tool
        return [*transforms, here]

    def gravity_torques(self, joints: Floats) -> Floats:
        """Return the torque of gravity about each joint's axis, N m; along a rail, its force, N.

        Args:
            joints: rad, (..., joints).

        Returns:
            (..., joints).
        """
        frames = self.frames(joints)[..., :-1, :, :]
        places = np.linalg.solve(self.joints, _homogeneous(self.centres)[..., None])
        centres = (frames @ places)[..., :3, 0]
        moments = np.flip(np.cumsum(np.flip(self.masses[:, None] * centres, -2), -2), -2)
        carried = np.flip(np.cumsum(np.flip(self.masses)))[:, None]
        levers = moments - carried * frames[..., :3, 3]
        axes = frames[..., :3, 2]
        torques = N_M_PER_N_MM * np.cross(axes, levers) @ GRAVITY_M_S2
        for rail in self.rails:
            torques[..., rail] = carried[rail] * axes[..., rail, :] @ GRAVITY_M_S2
        return torques


def _sum(parts: Iterable[Floats | None], shape: tuple[int, ...]) -> Floats:
    """Return the sum of those parts that are there, 0 without any."""
    return sum((part for part in parts if part is not None), np.zeros(shape))


def _turned(frames: Floats, angles: Floats) -> Floats:
    """Rotate frames about their own z axes; frames and angles broadcast."""
    shape = np.broadcast_shapes(frames.shape[:-2], angles.shape)
    transforms = np.empty((*shape, 4, 4))
    transforms[...] = frames
    cosine, sine = np.cos(angles)[..., None], np.sin(angles)[..., None]
    x, y = frames[..., :, 0], frames[..., :, 1]
    transforms[..., :, 0], transforms[..., :, 1] = cosine * x + sine * y, cosine * y - sine * x
    return transforms


def _slid(frames: Floats, ways: Floats) -> Floats:
    """Move frames along their own z axes, by m; frames and ways broadcast."""
    shape = np.broadcast_shapes(frames.shape[:-2], ways.shape)
    transforms = np.empty((*shape, 4, 4))
    transforms[...] = frames
    transforms[..., :3, 3] += MM_PER_M * ways[..., None] * frames[..., :3, 2]
    return transforms


def _homogeneous(points: Floats) -> Floats:
    return np.concatenate([points, np.ones((len(points), 1))], axis=1)
