"""Two arms as a kinematic calibration found them, and the file that keeps them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from twinct.errors import InputError
from twinct.files.boundary import read_text, shortened
from twinct.files.writing import storage_errors, write_text
from twinct.geometry import Chain, Floats, Misfit, Pose
from twinct.views import PosePairs

FORMAT = "twinct arms 1"

SIDES = ("source", "detector")

LARGEST_BYTES = 16 * 2**20

SAME_MM = 1e-6
"""Nominal frames of two cells that differ by less are those of one."""


class Change(NamedTuple):
    """How an arm differs from its chain; all may have the same axes before those told here.

    Attributes:
        links: twist of each joint's frame before its turn, (..., joints, 6), mm and rad.
        tool: of the tool's frame, (..., 6).
        compliance: of each joint behind its encoder, (..., joints), rad/(N m).
        gear: gear error, of the cosine and the sine of the periods of the joint's angle,
            (..., joints, 2), rad.
    """

    links: Floats
    tool: Floats
    compliance: Floats
    gear: Floats


def changed_tools(chain: Chain, change: Change, periods: int, joints: Floats) -> Floats:
    """``world_from_tool`` of an arm that differs from its chain.

    Args:
        chain: the nominal arm.
        change: how it differs.
        periods: of the gear error in a turn of a joint.
        joints: what the encoders read, (views, joints), rad.

    Returns:
        (..., views, 4, 4), mm.
    """
    gear = change.gear[..., None, :, :]
    behind = change.compliance[..., None, :] * chain.gravity_torques(joints)
    behind = behind + gear[..., 0] * np.cos(periods * joints)
    behind = behind + gear[..., 1] * np.sin(periods * joints)
    links, tool = change.links[..., None, :, :], change.tool[..., None, :]
    misfit = Misfit(base=np.zeros(6), links=links, tool=tool)
    return chain.tools(joints + behind, misfit)


@dataclass(frozen=True, eq=False)
class CalibratedArms:
    """What both arms are, in the frame of the phantom that they were calibrated with.

    Attributes:
        chains: nominal ones, source first.
        changes: of each arm.
        gear_periods: of the gear error in a turn of a joint.
        phantom_from_room: where the room in which the arms stand is in the phantom's frame.
        made_by: what made them, as plain data.
    """

    chains: tuple[Chain, Chain]
    changes: tuple[Change, Change]
    gear_periods: int
    phantom_from_room: Pose
    made_by: Mapping[str, Any]

    def __post_init__(self) -> None:
        """Lock the arrays."""
        for change in self.changes:
            for array in change:
                array.setflags(write=False)

    def tools(self, joints: Floats) -> tuple[Floats, Floats]:
        """Source and panel by what the encoders read.

        Args:
            joints: of both arms, source first, (views, joints), rad.

        Returns:
            ``phantom_from_tool`` of each arm, (views, 4, 4), mm.
        """
        first = len(self.chains[0])
        return self.tool(0, joints[:, :first]), self.tool(1, joints[:, first:])

    def tool(self, side: int, joints: Floats) -> Floats:
        """The same of one arm.

        Args:
            side: 0 source, 1 detector.
            joints: of this arm, (..., views, joints), rad.

        Returns:
            ``phantom_from_tool``, (..., views, 4, 4), mm.
        """
        tools = changed_tools(self.chains[side], self.changes[side], self.gear_periods, joints)
        return self.phantom_from_room.matrix @ tools

    def poses(self, joints: Floats) -> PosePairs:
        """The same as poses: the believed geometry of any trajectory."""
        sides = (
            tuple(Pose.from_matrix(at[:3, 3], at[:3, :3]) for at in tools)
            for tools in self.tools(joints)
        )
        return PosePairs(*sides)

    def write(self, path: Path) -> None:
        """Write a JSON file.

        Raises:
            StorageError: it cannot be written.
        """
        told: dict[str, Any] = {"format": FORMAT, "made_by": dict(self.made_by)}
        told["gear_periods"] = self.gear_periods
        place = self.phantom_from_room
        told["phantom_from_room"] = [*place.position.tolist(), *place.quat.tolist()]
        frames = frames_of(self.chains)
        for side, nominal, change in zip(SIDES, frames, self.changes, strict=True):
            numbers = {"nominal": nominal, **change._asdict()}
            told[side] = {key: array.tolist() for key, array in numbers.items()}
        with storage_errors(path):
            write_text(path, json.dumps(told, indent=1) + "\n")

    @classmethod
    def read(cls, path: Path, chains: tuple[Chain, Chain]) -> CalibratedArms:
        """Read what ``write`` wrote of the same arms.

        Args:
            path: the file.
            chains: nominal arms of the cell that is meant.

        Raises:
            InputError: it is no such file, or of another cell.
        """
        text = read_text(path, f"{path}: no calibrated arms: the file", LARGEST_BYTES)
        try:
            told = json.loads(text)
            if told["format"] != FORMAT:
                raise ValueError(f"format {told['format']!r}, this twinct reads {FORMAT!r}")
            changes = [_change(told[side], len(told[side]["nominal"]) - 2) for side in SIDES]
            nominal = [np.array(told[side]["nominal"], float) for side in SIDES]
            periods, made_by = int(told["gear_periods"]), dict(told["made_by"])
            place = np.array(told["phantom_from_room"], float)
            room = Pose(place[:3], place[3:])
        except Exception as error:  # JSON of any kind and depth
            kind = "" if type(error) is ValueError else f"{type(error).__name__}: "
            raise InputError(f"{path}: no calibrated arms: {shortened(f'{kind}{error}')}") from None
        require_same_arms((nominal[0], nominal[1]), chains, str(path))
        return cls(chains, (changes[0], changes[1]), periods, room, made_by)


def frames_of(chains: tuple[Chain, Chain]) -> tuple[Floats, Floats]:
    """Base, joints and tool of each nominal arm, (joints + 2, 4, 4), mm."""
    source, detector = (
        np.concatenate([chain.base[None], chain.joints, chain.tool[None]]) for chain in chains
    )
    return source, detector


def require_same_arms(
    frames: tuple[Floats, Floats], chains: tuple[Chain, Chain], where: str
) -> None:
    """Refuse arms that are others than those calibrated.

    Args:
        frames: as of ``frames_of``.
        chains: what they should be of.
        where: who says so.

    Raises:
        InputError: they are.
    """
    for side, one, other in zip(SIDES, frames, frames_of(chains), strict=True):
        if one.shape != other.shape:
            raise InputError(
                f"{where} is of another cell: {len(one) - 2} and {len(other) - 2} joints in the "
                f"{side} arms"
            )
        if not (off := float(np.abs(one - other).max())) <= SAME_MM:
            raise InputError(
                f"{where} is of another cell: frames of the nominal {side} arms lie up to "
                f"{off:.3g} mm apart"
            )


def _change(told: Mapping[str, Any], joints: int) -> Change:
    shapes = {"links": (joints, 6), "tool": (6,), "compliance": (joints,), "gear": (joints, 2)}
    found = Change(**{name: np.array(told[name], float) for name in shapes})
    for name, shape in shapes.items():
        array = getattr(found, name)
        if array.shape != shape or not np.isfinite(array).all():
            raise ValueError(f"{name}: {shape} finite numbers are needed")
    return found
