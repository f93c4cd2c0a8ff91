"""What is real: each term does to the tools what it is named after, and nothing else."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from drawn_arms import deviations

from twinct.geometry import Floats, Pose
from twinct.geometry.wire import PosePairs
from twinct.robots.cell import CellModel, chains_of
from twinct.scan.encoder_model import relative_to_specimen
from twinct.scenario import ArmErrors, Uncertainty
from twinct.uncertainty import TrueCell

STANDS = Pose.from_euler((5, -3, 2), (0, 0, 40))
SEED, ARMS_SEED = 4, 9


@pytest.fixture
def joints(cell: CellModel) -> Floats:
    return np.random.default_rng(1).uniform(-2, 2, (6, len(cell.joint_names)))


def told(cell: CellModel, joints: Floats) -> PosePairs:
    poses = []
    for chain, part in zip(chains_of(cell), cell.arm_joints, strict=True):
        matrix = chain.tools(joints[part])
        poses.append(Pose.from_matrix(matrix[:3, 3], matrix[:3, :3]))
    return PosePairs.at(*poses, STANDS)


def true_cell(cell: CellModel, **section: Any) -> TrueCell:
    found = Uncertainty.model_validate(section)
    assert found.moves
    return TrueCell(found, SEED, ARMS_SEED, chains_of(cell))


def at(
    true: TrueCell, cell: CellModel, joints: Floats, view: int = 0, time_s: float = 0.0
) -> PosePairs:
    return true.at(told(cell, joints), view, time_s, joints, np.zeros(len(joints)))


def test_nothing_is_off_by_default() -> None:
    assert not Uncertainty().moves
    assert not Uncertainty.model_validate({"encoder_step_deg": 1.0}).moves
    assert not Uncertainty.model_validate({"arms": {"ageing_mm": 1.0}}).moves


def test_a_tool_is_mounted_elsewhere_the_same_in_all_views(cell: CellModel, joints: Floats) -> None:
    true = true_cell(cell, arms={"tool_mm": 0.5, "tool_deg": 0.1})
    for side in ("source", "detector"):
        off = [
            (
                getattr(told(cell, q), side)[0].inverse() @ getattr(at(true, cell, q, v), side)[0]
            ).log()
            for v, q in enumerate(joints)
        ]
        np.testing.assert_allclose(off, np.broadcast_to(off[0], (len(joints), 6)), atol=1e-9)
        assert 0 < np.abs(off[0][:3]).max() < 2.5


def test_a_base_is_elsewhere_the_same_in_all_views(cell: CellModel, joints: Floats) -> None:
    true = true_cell(cell, arms={"base_mm": 0.5, "base_deg": 0.1})
    off = [
        (at(true, cell, q, v).source[0] @ told(cell, q).source[0].inverse()).log()
        for v, q in enumerate(joints)
    ]
    np.testing.assert_allclose(off, np.broadcast_to(off[0], (len(joints), 6)), atol=1e-8)
    assert np.abs(off[0]).max() > 0.01


def test_gravity_lowers_a_stretched_arm_by_its_torques(cell: CellModel) -> None:
    """A compliant shoulder under the weight of all that it carries."""
    true = true_cell(cell, arms={"windup_deg": 0.2})
    chain = chains_of(cell)[0]
    stretched = np.zeros(len(cell.joint_names))
    tools = [told(cell, stretched).source[0], at(true, cell, stretched).source[0]]
    assert -8.0 < tools[1].position[2] - tools[0].position[2] < -0.5
    torques = chain.gravity_torques(stretched[: len(chain)])
    turned = stretched.copy()
    turned[: len(chain)] += np.radians(0.2) * torques / chain.torque_limits
    assert told(cell, turned).source[0].distance_mm(tools[1]) < 1e-9


def test_an_image_comes_late_by_the_way_of_the_arms(cell: CellModel, joints: Floats) -> None:
    true = true_cell(cell, arms={"trigger_delay_ms": 5.0})
    speeds = np.random.default_rng(2).normal(size=joints.shape[1])
    found = true.at(told(cell, joints[0]), 0, 0.0, joints[0], speeds)
    later = told(cell, joints[0] + 0.005 * speeds)
    for side in ("source", "detector"):
        assert getattr(found, side)[0].distance_mm(getattr(later, side)[0]) < 1e-9


def test_a_gear_goes_round_and_arms_warm_up(cell: CellModel, joints: Floats) -> None:
    chain = chains_of(cell)[0]
    section = Uncertainty(arms=ArmErrors(gear_deg=0.02))
    gear = true_cell(cell, arms={"gear_deg": 0.02, "gear_periods": 2})
    phases = deviations(section, chain, ARMS_SEED, "source").gear[0]
    assert np.hypot(*phases.T) == pytest.approx(np.radians(0.02))
    turned = joints[0].copy()
    own = joints[0, : len(chain)]
    turned[: len(chain)] += phases[:, 0] * np.cos(2 * own) + phases[:, 1] * np.sin(2 * own)
    assert at(gear, cell, joints[0]).source[0].distance_mm(told(cell, turned).source[0]) < 1e-9
    warm = true_cell(cell, arms={"drift_mm": 0.1, "warm_up_min": 10.0})

    def missing(minutes: float) -> float:
        (here,) = at(warm, cell, joints[0], time_s=60 * minutes).source
        return here.distance_mm(told(cell, joints[0]).source[0])

    assert missing(10) == pytest.approx(missing(0) / np.e, rel=1e-6)


def test_views_differ_each_for_itself(cell: CellModel, joints: Floats) -> None:
    true = true_cell(cell, views={"detector_in_plane_mm": 0.2, "source_mm": 0.1})
    q = joints[0]
    here, still = told(cell, q), np.zeros(len(q))
    reals = [true.at(here, view, 0.0, q, still).detector[0] for view in range(400)]
    offs = np.array([(here.detector[0].inverse() @ real).log() for real in reals])
    assert offs[:, :2].std() == pytest.approx(0.2, rel=0.1)  # 800 draws: standard error 2.5 %
    assert np.abs(offs[:, 2:]).max() < 1e-9
    assert true.at(here, None, 0.0, q, still) == here


def test_a_patient_nods_and_jerks_and_is_followed() -> None:
    patient = {"nod_mm": 3, "nod_deg": 2, "nod_period_s": 8, "jerk_mm": 1, "jerk_at_s": 6}
    true = TrueCell(Uncertainty.model_validate({"patient": patient}), SEED, ARMS_SEED)
    source, panel = (
        Pose.from_euler((300, 0, 0), (0, 90, 0)),
        Pose.from_euler((-300, 0, 0), (0, 0, 0)),
    )
    here = PosePairs.at(source, panel, STANDS)
    at_s = {t: true.at(here, 0, t).object[0] for t in (0.0, 4.0, 8.0)}
    assert at_s[0.0].distance_mm(STANDS) < 1e-9
    assert at_s[4.0].angle_deg(STANDS) == pytest.approx(2.0, abs=1e-6)
    # After a whole period it is back, but for the jerk.
    assert at_s[8.0].distance_mm(STANDS) == pytest.approx(1.0, rel=1e-6)
    moved = at_s[4.0]
    (seen, _) = relative_to_specimen(STANDS, (moved,), PosePairs((source,), (panel,)))[0]
    point = np.array([10.0, 20.0, 30.0])  # of the specimen
    as_it_was, as_it_is = (
        seen.inverse().apply(STANDS.apply(point)),
        source.inverse().apply(moved.apply(point)),
    )
    np.testing.assert_allclose(as_it_was, as_it_is, atol=1e-9)


def test_more_arms_begin_with_the_one_of_the_scan(cell: CellModel) -> None:
    section = Uncertainty.model_validate({"preset": "collaborative"})
    chain = chains_of(cell)[0]
    one, many = (deviations(section, chain, 7, "source", draws) for draws in (1, 5))
    np.testing.assert_array_equal(one.links[0], many.links[0])
    np.testing.assert_array_equal(one.gear[0], many.gear[0])
    other = deviations(section, chain, 7, "detector")
    assert not np.array_equal(one.tool, other.tool)
