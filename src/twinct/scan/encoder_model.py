"""Source and panel poses according to the controllers, and relative to the specimen."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twinct.core.errors import InputError
from twinct.geometry import Chain, Floats, Panel, Pose
from twinct.geometry.wire import PosePairs
from twinct.scenario import AnyCell, Cell, Uncertainty


@dataclass(frozen=True)
class EncoderModel:
    """The controllers' model: encoder readings of a scan's joints, and the poses that they give.

    The arms are the nominal ones, or those of ``uncertainty.calibration``.

    Attributes:
        cell: the operating room.
        panel: the panel.
        uncertainty: errors that are simulated.
    """

    cell: AnyCell
    panel: Panel
    uncertainty: Uncertainty

    @cached_property
    def _nominal(self) -> tuple[Chain, Chain]:
        """Nominal kinematics of both arms."""
        from twinct.robots.cell import nominal_chains

        assert isinstance(self.cell, Cell)
        return nominal_chains(self.cell, self.panel)

    def nominal_poses(self, commanded: PosePairs, executed: PosePairs, joints: Floats) -> PosePairs:
        """Return the poses that the controllers compute from the encoder readings of the views.

        Raises:
            InputError: the file of calibrated arms is invalid, or belongs to another cell.
            MissingExtraError: MuJoCo is not installed, and the arms differ from the nominal model.
            ScenarioError: an arm can no longer be built.
        """
        section = self.uncertainty
        if not section.moves and not section.encoder_step_deg and not section.calibration:
            return executed
        if not isinstance(self.cell, Cell):
            taken = slice(len(executed))
            return PosePairs(commanded.source[taken], commanded.detector[taken])
        return self.poses(self.readings(joints))

    def poses(self, joints: Floats) -> PosePairs:
        """Return the poses of source and panel for encoder readings; the cell must have arms.

        Args:
            joints: readings of both arms, source first, (views, joints), rad.

        Raises:
            InputError: another number of joints, or the file of calibrated arms is invalid or
                belongs to another cell.
            MissingExtraError: MuJoCo is not installed.
            ScenarioError: an arm can no longer be built.
        """
        chains = self._nominal
        counts = [len(chain) for chain in chains]
        if joints.shape[1] != sum(counts):
            raise InputError(
                f"{joints.shape[1]} joints of each view, but the cell's source arm has {counts[0]} "
                f"and its detector arm {counts[1]}"
            )
        if calibration := self.uncertainty.calibration:
            from twinct.robots.calibrated_arms import CalibratedArms

            return CalibratedArms.read(calibration, chains).poses(joints)
        source, detector = np.split(joints, counts[:1], axis=1)
        sides = (
            tuple(map(_pose, chain.tools(own)))
            for chain, own in zip(chains, (source, detector), strict=True)
        )
        return PosePairs(*sides)

    def readings(self, joints: Floats) -> Floats:
        """Return the encoder readings of joint positions, rad, in the shape of the input.

        Rails are read exactly.
        """
        step = math.radians(self.uncertainty.encoder_step_deg)
        if not step:
            return joints
        read, cell = step * np.round(joints / step), self.cell
        if isinstance(cell, Cell) and (cell.source_arm.rail or cell.detector_arm.rail):
            hinges = np.concatenate([chain.hinges for chain in self._nominal])
            read = np.where(hinges, read, joints)
        return read


def relative_to_specimen(stands: Pose, objects: tuple[Pose, ...], executed: PosePairs) -> PosePairs:
    """Return source and panel poses relative to a moving specimen, as if it had stayed in place.

    Args:
        stands: ``world_from_object`` of the fixed place.
        objects: ``world_from_object`` of each view.
        executed: executed poses of each view.
    """
    back = [stands @ moved.inverse() for moved in objects]
    sides = (
        tuple(to @ pose for to, pose in zip(back, side, strict=True))
        for side in (executed.source, executed.detector)
    )
    return PosePairs(*sides)


def _pose(matrix: Floats) -> Pose:
    return Pose.from_matrix(matrix[:3, 3], matrix[:3, :3])
