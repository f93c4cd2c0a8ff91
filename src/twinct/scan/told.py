"""Where the controllers take source and panel to be, and how the specimen sees them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from twinct.calibration import CalibratedArms
from twinct.geometry import Floats, Pose
from twinct.scenario import Cell, Scenario
from twinct.uncertainty import Evidence
from twinct.views import PosePairs


def evidence_of(
    scenario: Scenario,
    commanded: PosePairs,
    executed: PosePairs,
    joint_names: tuple[str, ...],
    joints: NDArray[np.float64],
) -> Evidence:
    """What the controllers know of some views: encoders, and the nominal model's poses of them.

    With ``uncertainty.calibration``, the calibrated arms' poses.

    Raises:
        InputError: calibrated arms that are no such file, or of another cell.
        MissingExtraError: MuJoCo is not installed, and there are arms that are not as known.
        ScenarioError: an arm that cannot be built any more.
    """
    section = scenario.uncertainty
    if not section.moves and not section.encoder_step_deg and not section.calibration:
        return Evidence(scenario.cell, joint_names, joints, executed)
    if not isinstance(scenario.cell, Cell):
        taken = slice(len(executed))
        told = PosePairs(commanded.source[taken], commanded.detector[taken])
        return Evidence(scenario.cell, joint_names, joints, told)
    from twinct.cell import nominal_chains

    joints = encoders_of(scenario, joints)
    chains = nominal_chains(scenario.cell, scenario.detector.panel)
    if section.calibration:
        told = CalibratedArms.read(section.calibration, chains).poses(joints)
        return Evidence(scenario.cell, joint_names, joints, told)
    sides: list[tuple[Pose, ...]] = []
    first = 0
    for chain in chains:
        own = slice(first, first := first + len(chain))
        sides.append(tuple(map(_pose, chain.tools(joints[:, own]))))
    source, detector = sides
    return Evidence(scenario.cell, joint_names, joints, PosePairs(source, detector))


def encoders_of(scenario: Scenario, joints: Floats) -> Floats:
    """What the encoders tell of where the joints stand, rad, in the same shape."""
    step = math.radians(scenario.uncertainty.encoder_step_deg)
    return step * np.round(joints / step) if step else joints


def seen_from(stands: Pose, objects: tuple[Pose, ...], executed: PosePairs) -> PosePairs:
    """Source and panel as a specimen sees them that has moved, had it kept its place.

    Args:
        stands: ``world_from_object`` of the place.
        objects: ``world_from_object`` of each view.
        executed: of each view.
    """
    back = [stands @ moved.inverse() for moved in objects]
    sides = (
        tuple(to @ pose for to, pose in zip(back, side, strict=True))
        for side in (executed.source, executed.detector)
    )
    return PosePairs(*sides)


def _pose(matrix: Floats) -> Pose:
    return Pose.from_matrix(matrix[:3, 3], matrix[:3, :3])
