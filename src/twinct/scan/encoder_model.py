"""Source and panel poses according to the controllers, and relative to the specimen."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError
from twinct.geometry import Floats, Pose
from twinct.geometry.wire import PosePairs
from twinct.scenario import Cell, Scenario


def nominal_poses(
    scenario: Scenario, commanded: PosePairs, executed: PosePairs, joints: NDArray[np.float64]
) -> PosePairs:
    """Return the poses that the controllers compute from the encoder readings of the views.

    Their model of the arms is the nominal one, or that of ``uncertainty.calibration``.

    Raises:
        InputError: the file of calibrated arms is invalid, or belongs to another cell.
        MissingExtraError: MuJoCo is not installed, and the arms differ from the nominal model.
        ScenarioError: an arm can no longer be built.
    """
    section = scenario.uncertainty
    if not section.moves and not section.encoder_step_deg and not section.calibration:
        return executed
    if not isinstance(scenario.cell, Cell):
        taken = slice(len(executed))
        return PosePairs(commanded.source[taken], commanded.detector[taken])
    return poses_of_joints(scenario, encoders_of(scenario, joints))


def poses_of_joints(scenario: Scenario, joints: Floats) -> PosePairs:
    """Return the poses of source and panel for encoder readings of a scenario's cell.

    The arms are nominal, or those of ``uncertainty.calibration``.

    Args:
        scenario: scenario whose cell has arms.
        joints: readings of both arms, source first, (views, joints), rad.

    Raises:
        InputError: another number of joints, or the file of calibrated arms is invalid or belongs
            to another cell.
        MissingExtraError: MuJoCo is not installed.
        ScenarioError: an arm can no longer be built.
    """
    from twinct.robots.cell import nominal_chains

    assert isinstance(scenario.cell, Cell)
    chains = nominal_chains(scenario.cell, scenario.detector.panel)
    counts = [len(chain) for chain in chains]
    if joints.shape[1] != sum(counts):
        raise InputError(
            f"{joints.shape[1]} joints of each view, but the cell's source arm has {counts[0]} and "
            f"its detector arm {counts[1]}"
        )
    if calibration := scenario.uncertainty.calibration:
        from twinct.robots.calibrated_arms import CalibratedArms

        return CalibratedArms.read(calibration, chains).poses(joints)
    source, detector = np.split(joints, counts[:1], axis=1)
    sides = (
        tuple(map(_pose, chain.tools(own)))
        for chain, own in zip(chains, (source, detector), strict=True)
    )
    return PosePairs(*sides)


def encoders_of(scenario: Scenario, joints: Floats) -> Floats:
    """Return the encoder readings of joint positions, rad, in the shape of the input.

    Rails are read exactly.
    """
    step = math.radians(scenario.uncertainty.encoder_step_deg)
    if not step:
        return joints
    read, cell = step * np.round(joints / step), scenario.cell
    if isinstance(cell, Cell) and (cell.source_arm.rail or cell.detector_arm.rail):
        from twinct.robots.cell import nominal_chains

        chains = nominal_chains(cell, scenario.detector.panel)
        hinges = np.concatenate([chain.hinges for chain in chains])
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
