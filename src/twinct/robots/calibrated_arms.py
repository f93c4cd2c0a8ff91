"""Two arms as estimated by a kinematic calibration, and the file that stores them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from twinct.core.errors import InputError
from twinct.core.files.boundary import read_text
from twinct.core.files.writing import storage_errors, write_text
from twinct.core.foreign_text import quoted, shortened
from twinct.geometry import Chain, Floats, Misfit, Pose
from twinct.geometry.wire import PosePairs
from twinct.uncertainty.error_terms import SIDES
from twinct.uncertainty.terms.gear import waves
from twinct.uncertainty.terms.windup import deflections

FORMAT = "twinct arms 1"

LARGEST_BYTES = 16 * 2**20

SAME_MM = 1e-6
"""Maximum difference between the nominal frames of one cell."""


class ArmDeviations(NamedTuple):
    """Deviations of an arm from its nominal chain, with any number of leading axes.

    Attributes:
        links: twist of each joint's frame, applied before the joint's turn, (..., joints, 6), mm
            and rad.
        tool: twist of the tool's frame, (..., 6), mm and rad.
        compliance: compliance of each joint behind its encoder, (..., joints), rad/(N m).
        gear: amplitudes of each joint's gear error, for the cosine and the sine of the joint angle
            times the number of periods, (..., joints, 2), rad.
    """

    links: Floats
    tool: Floats
    compliance: Floats
    gear: Floats


def changed_tools(chain: Chain, change: ArmDeviations, periods: int, joints: Floats) -> Floats:
    """Return ``world_from_tool`` of an arm that deviates from its chain.

    Args:
        chain: the nominal arm.
        change: the arm's deviations.
        periods: periods of the gear error in one turn of a joint.
        joints: encoder readings, (views, joints), rad.

    Returns:
        (..., views, 4, 4), mm.
    """
    misfit = Misfit(
        links=change.links[..., None, :, :],
        tool=change.tool[..., None, :],
        joints=(
            deflections(change.compliance, chain, joints),
            *waves(change.gear, periods, joints),
        ),
    )
    return chain.tools(joints, misfit)


@dataclass(frozen=True, eq=False)
class CalibratedArms:
    """Both arms in the frame of the phantom with which they were calibrated.

    Attributes:
        chains: nominal chains, source first.
        changes: deviations of each arm.
        gear_periods: periods of the gear error in one turn of a joint.
        phantom_from_room: pose, in the phantom's frame, of the room in which the arms stand.
        made_by: provenance as plain data.
    """

    chains: tuple[Chain, Chain]
    changes: tuple[ArmDeviations, ArmDeviations]
    gear_periods: int
    phantom_from_room: Pose
    made_by: Mapping[str, Any]

    def __post_init__(self) -> None:
        """Lock the arrays."""
        for change in self.changes:
            for array in change:
                array.setflags(write=False)

    def tools(self, joints: Floats) -> tuple[Floats, Floats]:
        """Return the poses of source and panel for the given encoder readings.

        Args:
            joints: encoder readings of both arms, source first, (views, joints), rad.

        Returns:
            ``phantom_from_tool`` of each arm, (views, 4, 4), mm.
        """
        first = len(self.chains[0])
        return self.tool(0, joints[:, :first]), self.tool(1, joints[:, first:])

    def tool(self, side: int, joints: Floats) -> Floats:
        """Return the tool poses of one arm.

        Args:
            side: 0 for the source, 1 for the detector.
            joints: encoder readings of this arm, (..., views, joints), rad.

        Returns:
            ``phantom_from_tool``, (..., views, 4, 4), mm.
        """
        tools = changed_tools(self.chains[side], self.changes[side], self.gear_periods, joints)
        return self.phantom_from_room.matrix @ tools

    def poses(self, joints: Floats) -> PosePairs:
        """Return both arms' tools as poses: the believed geometry of any trajectory."""
        sides = (
            tuple(Pose.from_matrix(at[:3, 3], at[:3, :3]) for at in tools)
            for tools in self.tools(joints)
        )
        return PosePairs(*sides)

    def write(self, path: Path) -> None:
        """Write the arms to a JSON file.

        Raises:
            StorageError: the file cannot be written.
        """
        data: dict[str, Any] = {"format": FORMAT, "made_by": dict(self.made_by)}
        data["gear_periods"] = self.gear_periods
        place = self.phantom_from_room
        data["phantom_from_room"] = [*place.position.tolist(), *place.quat.tolist()]
        frames = frames_of(self.chains)
        for side, nominal, change in zip(SIDES, frames, self.changes, strict=True):
            numbers = {"nominal": nominal, **change._asdict()}
            data[side] = {key: array.tolist() for key, array in numbers.items()}
        with storage_errors(path):
            write_text(path, json.dumps(data, indent=1) + "\n")

    @classmethod
    def read(cls, path: Path, chains: tuple[Chain, Chain]) -> CalibratedArms:
        """Read the arms from a file that ``write`` wrote.

        Args:
            path: the file.
            chains: nominal arms of the cell.

        Raises:
            InputError: the file does not hold calibrated arms, or belongs to another cell.
        """
        text = read_text(path, f"{path}: the file of calibrated arms", LARGEST_BYTES)
        try:
            data = json.loads(text)
            if data["format"] != FORMAT:
                raise ValueError(
                    f"format {quoted(data['format'])}, but this twinct reads {FORMAT!r}"
                )
            changes = [_change(data[side], len(data[side]["nominal"]) - 2) for side in SIDES]
            nominal = [np.array(data[side]["nominal"], float) for side in SIDES]
            periods, made_by = int(data["gear_periods"]), dict(data["made_by"])
            place = np.array(data["phantom_from_room"], float)
            room = Pose(place[:3], place[3:])
        except Exception as error:  # malformed JSON raises many types
            kind = "" if type(error) is ValueError else f"{type(error).__name__}: "
            raise InputError(
                f"{path}: not calibrated arms: {shortened(f'{kind}{error}')}"
            ) from None
        require_same_arms((nominal[0], nominal[1]), chains, str(path))
        return cls(chains, (changes[0], changes[1]), periods, room, made_by)


def frames_of(chains: tuple[Chain, Chain]) -> tuple[Floats, Floats]:
    """Return base, joints and tool of each nominal arm, (joints + 2, 4, 4), mm."""
    source, detector = (
        np.concatenate([chain.base[None], chain.joints, chain.tool[None]]) for chain in chains
    )
    return source, detector


def require_same_arms(
    frames: tuple[Floats, Floats], chains: tuple[Chain, Chain], where: str
) -> None:
    """Raise an error unless the arms are those of the calibration.

    Args:
        frames: calibrated frames, as returned by ``frames_of``.
        chains: nominal arms to compare with.
        where: origin of the frames, for messages.

    Raises:
        InputError: the arms differ.
    """
    for side, one, other in zip(SIDES, frames, frames_of(chains), strict=True):
        if one.shape != other.shape:
            raise InputError(
                f"{where} belongs to another cell: its {side} arm has {len(one) - 2} joints, this "
                f"cell's has {len(other) - 2}"
            )
        if not (off := float(np.abs(one - other).max())) <= SAME_MM:
            raise InputError(
                f"{where} belongs to another cell: frames of the nominal {side} arms lie up to "
                f"{off:.3g} mm apart"
            )


def _change(data: Mapping[str, Any], joints: int) -> ArmDeviations:
    shapes = {"links": (joints, 6), "tool": (6,), "compliance": (joints,), "gear": (joints, 2)}
    change = ArmDeviations(**{name: np.array(data[name], float) for name in shapes})
    for name, shape in shapes.items():
        array = getattr(change, name)
        if array.shape != shape or not np.isfinite(array).all():
            raise ValueError(f"{name}: {shape} finite numbers are needed")
    return change
