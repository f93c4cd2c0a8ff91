"""Errors of one arm that differ from those of both."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from twinct.calibration.arm_calibration import arm_prior
from twinct.geometry import Pose
from twinct.geometry.wire import PosePairs
from twinct.robots.cell import CellModel, chains_of
from twinct.scenario import Uncertainty
from twinct.uncertainty import TrueCell
from twinct.uncertainty.nominal_scan import NominalScan
from twinct.uncertainty.sections import PRESETS

STRETCHED = np.zeros((1, 12))


def section(arms: dict[str, Any], **keys: Any) -> Uncertainty:
    return Uncertainty.model_validate({"arms": arms, **keys})


def test_each_arm_sags_by_its_own_compliance(cell: CellModel) -> None:
    asked = section({"windup_deg": 0.2, "detector": {"windup_deg": 0.05}})
    chains = chains_of(cell)
    scan = NominalScan.of_arms(chains, STRETCHED, 0 * STRETCHED, np.zeros(1))
    poses = [Pose.from_matrix(m[0, :3, 3], m[0, :3, :3]) for m in scan.poses]
    true = TrueCell(asked, 1, 2, chains)
    real = true.at(
        PosePairs.at(poses[0], poses[1], Pose.identity()), 0, 0.0, STRETCHED[0], 0 * STRETCHED[0]
    )
    for chain, own, windup_deg in zip(chains, real[0], (0.2, 0.05), strict=True):
        joints = STRETCHED[0, : len(chain)]
        turn = np.radians(windup_deg) * chain.gravity_torques(joints) / chain.torque_limits
        assert np.abs(turn).max() > 1e-4
        np.testing.assert_allclose(own.matrix, chain.tools((joints + turn)[None])[0], atol=1e-9)


def test_keys_of_one_arm_come_before_those_of_both_and_both_before_the_preset() -> None:
    asked = section(
        {"gear_deg": 0.5, "source": {"windup_deg": 0.02, "gear_deg": 0.0}}, preset="collaborative"
    )
    preset = PRESETS["collaborative"]["arms"]
    source, detector = asked.arms.of("source"), asked.arms.of("detector")
    assert (source.windup_deg, source.gear_deg) == (0.02, 0.0)
    assert (detector.windup_deg, detector.gear_deg) == (preset["windup_deg"], 0.5)
    assert source.link_mm == detector.link_mm == preset["link_mm"]
    again = Uncertainty.model_validate(asked.model_dump(mode="json"))
    assert again == asked and again.arms.of("source") == source


def test_an_error_of_one_arm_alone_makes_arms_move() -> None:
    asked = section({"detector": {"windup_deg": 0.1}})
    assert asked.moves and asked.of_arms == ("arms",)
    ageing = section({"age_months": 3.0, "source": {"ageing_mm": 0.1}})
    assert ageing.moves
    assert (
        not section({"windup_deg": 0.1, "source": {"windup_deg": 0}}).arms.of("source").windup_deg
    )


def test_a_calibration_expects_of_each_arm_its_own_errors(cell: CellModel) -> None:
    asked = section({"link_mm": 0.1, "windup_deg": 0.2, "source": {"windup_deg": 0.02}})
    scan = NominalScan.of_arms(chains_of(cell), STRETCHED, 0 * STRETCHED, np.zeros(1))
    source, detector = (arm_prior(asked, scan.motion(side)) for side in range(2))
    np.testing.assert_allclose(source.compliance, detector.compliance / 10)
    assert source.link == pytest.approx(detector.link)
