"""Arms found from views of a phantom, against true arms that the error model moves."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from drawn_arms import deviations, still, true_tools

from twinct.calibration import (
    CalibratedArms,
    KinematicCalibration,
    PhantomViews,
    calibrated_arms,
    moved,
)
from twinct.calibration.arm_calibration import arm_prior
from twinct.calibration.kinematics import ArmPrior, minimal_from_full
from twinct.core.errors import CalibrationError, InputError
from twinct.geometry import Chain, Floats, Misfit, Panel, Pose, ScanGeometry
from twinct.robots.cell import CellModel, build_cell, chains_of
from twinct.scenario import Cell, Detector, Uncertainty

SIDES = ("source", "detector")
PANEL = Panel(240, 320, 1.0, 1.0)
SECTION = Uncertainty.model_validate({"preset": "collaborative", "arms": {"drift_mm": 0}})
COVARIANCE = np.diag([0.02, 0.02, 0.1] * 2 + [2e-4, 2e-4, 2e-5]) ** 2
"""Of each view's nine numbers, mm and rad: as balls tell them, other along the ray than across."""


class Arms(NamedTuple):
    """Nominal arms, what is known of them, and views of true ones."""

    chains: tuple[Chain, Chain]
    priors: tuple[ArmPrior, ArmPrior]
    true: tuple[Floats, Floats]
    joints: Floats


@pytest.fixture
def arms(cell: CellModel) -> Arms:
    """Views all over what joints can do, of arms that the error model drew."""
    chains = chains_of(cell)
    joints = np.random.default_rng(3).uniform(-2, 2, (400, 12))
    joints = joints[facing(chains, joints)][:100]
    return Arms(chains, priors(chains), true(chains, joints), joints)


def priors(
    chains: tuple[Chain, Chain], section: Uncertainty = SECTION
) -> tuple[ArmPrior, ArmPrior]:
    source, panel = (
        arm_prior(section, still(chain, side, np.zeros((1, len(chain)))))
        for chain, side in zip(chains, SIDES, strict=True)
    )
    return source, panel


def facing(chains: tuple[Chain, Chain], joints: Floats) -> np.ndarray:
    """Which configurations show the source the panel's front, with some room."""
    source, panel = (
        chain.tools(own) for chain, own in zip(chains, np.split(joints, 2, axis=1), strict=True)
    )
    return np.einsum("vi,vi->v", panel[:, :3, 2], (source - panel)[:, :3, 3]) > 50


def true(
    chains: tuple[Chain, Chain], joints: Floats, section: Uncertainty = SECTION
) -> tuple[Floats, Floats]:
    """Tools of true arms at rest, without repeatability."""
    source, panel = (
        true_tools(section, chain, 5, side, own)
        for side, chain, own in zip(SIDES, chains, np.split(joints, 2, axis=1), strict=True)
    )
    return source, panel


def seen(arms: Arms, views: slice, rng: np.random.Generator | None = None) -> PhantomViews:
    """What the views tell, each number off by its spread where there is a generator."""
    source, panel = (tools[views] for tools in arms.true)
    geometry = ScanGeometry(
        source[:, :3, 3], panel[:, :3, 3], panel[:, :3, 0], panel[:, :3, 1], PANEL
    )
    if rng is not None:
        off = rng.normal(size=(len(source), 9)) * np.sqrt(np.diag(COVARIANCE))
        geometry = ScanGeometry.joined(
            [moved(view, change) for view, change in zip(geometry, off, strict=True)]
        )
    return PhantomViews(
        arms.joints[views], geometry, np.broadcast_to(COVARIANCE, (len(source), 9, 9))
    )


def off_mm(arms: Arms, found: tuple[Floats, Floats], views: slice) -> list[float]:
    """RMS distance of source and of panel centre from where they are."""
    return [
        float(np.sqrt(((a[views, :3, 3] - b[views, :3, 3]) ** 2).sum(axis=1).mean()))
        for a, b in zip(arms.true, found, strict=True)
    ]


def nominal(arms: Arms) -> tuple[Floats, Floats]:
    return (
        arms.chains[0].tools(arms.joints[:, :6]),
        arms.chains[1].tools(arms.joints[:, 6:]),
    )


FITTED, UNSEEN = slice(0, 60), slice(60, 100)


def test_the_minimal_set_moves_tools_as_all_twists_do(arms: Arms) -> None:
    """To first order: what is left is of the order of the twists' squares."""
    chain, rng = arms.chains[1], np.random.default_rng(0)
    sigma = 1e-4 * np.array([300.0] * 3 + [1.0] * 3)
    full = sigma * rng.normal(size=(8, 6))
    minimal = minimal_from_full(chain) @ full.ravel()
    links = np.zeros((6, 6))
    links[:, [0, 1, 3, 4]] = minimal[:24].reshape(6, 4)
    joints = arms.joints[:, 6:]
    everything = chain.tools(joints, Misfit(full[0], full[1:7], full[7]))
    few = chain.tools(joints, Misfit(np.zeros(6), links, minimal[24:]))
    moved = np.abs(everything - chain.tools(joints))[:, :3, 3].max()
    assert np.abs(everything - few)[:, :3, 3].max() < 1e-3 * moved
    assert np.abs(everything - few)[:, :3, :3].max() < 1e-6


def test_the_minimal_set_of_an_arm_on_a_rail_moves_tools_as_all_twists_do() -> None:
    """Of the rail, the minimal set has two tilts."""
    section = Cell.model_validate({"source_arm": {"rail": {"range_mm": [-900, 900]}}})
    chain = chains_of(build_cell(section, None, Pose.identity(), Detector().panel))[0]
    rng, count = np.random.default_rng(0), len(chain)
    full = 1e-4 * np.array([300.0] * 3 + [1.0] * 3) * rng.normal(size=(count + 2, 6))
    minimal = minimal_from_full(chain) @ full.ravel()
    links = np.zeros((count, 6))
    links[:, [0, 1, 3, 4]] = minimal[: 4 * count].reshape(count, 4)
    assert np.abs(links[0, :3]).max() == 0 < np.abs(links[0, 3:5]).min()
    joints = np.column_stack([rng.uniform(-0.9, 0.9, 20), rng.uniform(-2, 2, (20, 6))])
    everything = chain.tools(joints, Misfit(full[0], full[1:-1], full[-1]))
    few = chain.tools(joints, Misfit(np.zeros(6), links, minimal[4 * count :]))
    moved = np.abs(everything - chain.tools(joints))[:, :3, 3].max()
    assert np.abs(everything - few)[:, :3, 3].max() < 2e-3 * moved
    assert np.abs(everything - few)[:, :3, :3].max() < 1e-6


def test_nobody_has_to_know_where_the_phantom_stands(arms: Arms) -> None:
    """All is found in the phantom's frame."""
    place = Pose.from_euler((200.0, -150.0, 90.0), (20.0, -10.0, 130.0))
    views = seen(arms, FITTED, np.random.default_rng(4))
    elsewhere = replace(views, geometry=place @ views.geometry)
    here, there = (
        calibrated_arms(arms.chains, one, arms.priors).arms.tools(arms.joints)
        for one in (views, elsewhere)
    )
    for one, other in zip(here, there, strict=True):
        assert np.abs(place.matrix @ one - other)[:, :3, 3].max() < 1e-3, "mm"


def test_views_without_noise_give_the_arms(arms: Arms) -> None:
    exact = replace(seen(arms, FITTED), covariance=np.broadcast_to(1e-6 * COVARIANCE, (60, 9, 9)))
    found = calibrated_arms(arms.chains, exact, arms.priors)
    assert min(off_mm(arms, nominal(arms), UNSEEN)) > 1.0
    # Terms that the prior alone tells are left: gears that turn a source on its axis, and such.
    assert max(off_mm(arms, found.arms.tools(arms.joints), UNSEEN)) < 2e-3
    turned = (
        found.arms.tools(arms.joints)[1][:, :3, :3].transpose(0, 2, 1) @ arms.true[1][:, :3, :3]
    )
    assert np.abs(turned - np.eye(3)).max() < 1e-5


def test_unseen_poses_are_predicted_and_the_spread_of_parameters_is_told(arms: Arms) -> None:
    found = calibrated_arms(arms.chains, seen(arms, FITTED, np.random.default_rng(1)), arms.priors)
    assert max(off_mm(arms, found.arms.tools(arms.joints), UNSEEN)) < 0.12
    assert 0.85 < found.misfit < 1.15
    drawn = [
        deviations(SECTION, chain, 5, side) for chain, side in zip(arms.chains, SIDES, strict=True)
    ]
    behind = [np.concatenate([one.compliance[0], one.gear[0].ravel()]) for one in drawn]
    where = [i for i, name in enumerate(found.names) if "compliance" in name or "gear" in name]
    sigma = np.sqrt(np.diag(found.covariance)[where])
    apart = (found.parameters[where] - np.concatenate(behind)) / sigma
    assert 0.7 < np.sqrt((apart**2).mean()) < 1.3
    assert 0.06 < min(found.predicted_mm) and max(found.predicted_mm) < 0.25, found.predicted_mm


def names_of(found: KinematicCalibration, arm: str) -> frozenset[str]:
    return frozenset(part for one in found.undetermined if one.arm == arm for part in one.parts)


def test_combinations_that_no_view_can_tell_are_named(arms: Arms) -> None:
    """A vertical hinge carries nothing; what turns a point on its own axis moves nothing."""
    found = calibrated_arms(arms.chains, seen(arms, FITTED), arms.priors)
    for arm in ("source", "detector"):
        assert f"{arm} arm: +1.0 joint 1 compliance" in map(str, found.undetermined)
        assert "joint 2 compliance" not in names_of(found, arm)
    for part in ("cos", "sin"):
        assert f"source arm: +1.0 joint 6 gear {part}" in map(str, found.undetermined)
    assert not {"joint 6 gear cos", "joint 6 gear sin"} & names_of(found, "detector")
    assert all(0.7 < one.left <= 1 for one in found.undetermined)


def test_views_along_one_arc_leave_what_does_not_move_untold(arms: Arms) -> None:
    joints = np.broadcast_to(arms.joints[0], (30, 12)).copy()
    joints[:, 0] += np.linspace(-0.5, 0.5, 30)
    joints[:, 6] += np.linspace(-0.5, 0.5, 30)
    joints = joints[facing(arms.chains, joints)]
    along = arms._replace(joints=joints, true=true(arms.chains, joints))
    found = calibrated_arms(arms.chains, seen(along, slice(None)), arms.priors)
    everywhere = calibrated_arms(arms.chains, seen(arms, FITTED), arms.priors)
    for arm in ("source", "detector"):
        more, few = (
            [one for one in of.undetermined if one.arm == arm] for of in (found, everywhere)
        )
        assert len(more) > len(few) + 10
        assert {"joint 3 compliance", "joint 4 about x"} <= names_of(found, arm)
        unseen = [set(one.parts) for one in more if one.left > 0.999]
        for one in unseen:
            assert one - set().union(*(other for other in unseen if other is not one))
    assert max(off_mm(arms, found.arms.tools(arms.joints), UNSEEN)) > 0.3


def test_joints_that_turn_the_other_way_are_refused(arms: Arms) -> None:
    views = seen(arms, FITTED)
    wrong = views.joints.copy()
    wrong[:, 2] *= -1
    with pytest.raises(CalibrationError, match=r"do not explain the views.*signs and order"):
        calibrated_arms(arms.chains, replace(views, joints=wrong), arms.priors)


def test_a_term_that_is_not_modelled_is_seen_in_what_is_left(arms: Arms) -> None:
    """Gears that err three times a turn, and a calibration that takes them for once a turn."""
    section = Uncertainty.model_validate(
        {"preset": "collaborative", "arms": {"drift_mm": 0, "gear_deg": 0.015, "gear_periods": 3}}
    )
    bent = arms._replace(true=true(arms.chains, arms.joints, section))
    noise = np.random.default_rng(2)
    views, known = seen(bent, FITTED, noise), priors(arms.chains, section)
    right = calibrated_arms(arms.chains, views, known, gear_periods=3)
    assert right.misfit < 1.2
    assert max(off_mm(bent, right.arms.tools(arms.joints), UNSEEN)) < 0.15
    wrong = calibrated_arms(arms.chains, views, known, gear_periods=1)
    assert wrong.misfit > 2 * right.misfit
    assert min(wrong.predicted_mm) > 2 * max(right.predicted_mm)
    assert min(off_mm(bent, wrong.arms.tools(arms.joints), UNSEEN)) > 0.2


def test_too_few_views_are_refused(arms: Arms) -> None:
    with pytest.raises(CalibrationError, match=r"8 views show the arms, but at least 9 are needed"):
        calibrated_arms(arms.chains, seen(arms, slice(0, 8)), arms.priors)
    found = calibrated_arms(arms.chains, seen(arms, slice(0, 9)), arms.priors)
    assert len(found.undetermined) > 20


def test_arms_are_kept_in_a_file_of_their_cell(arms: Arms, tmp_path: Path) -> None:
    found = calibrated_arms(arms.chains, seen(arms, FITTED), arms.priors).arms
    path = tmp_path / "arms.json"
    found.write(path)
    again = CalibratedArms.read(path, arms.chains)
    for one, other in zip(found.tools(arms.joints), again.tools(arms.joints), strict=True):
        np.testing.assert_array_equal(one, other)
    shifted = arms.chains[1].tool.copy()
    shifted[0, 3] += 5.0
    other = arms.chains[0], replace(arms.chains[1], tool=shifted)
    with pytest.raises(InputError, match=r"to another cell: .* detector arms lie up to 5 mm"):
        CalibratedArms.read(path, other)
    told = json.loads(path.read_text())
    told["source"]["gear"].pop()
    path.write_text(json.dumps(told))
    with pytest.raises(InputError, match="not calibrated arms: gear"):
        CalibratedArms.read(path, arms.chains)
    with pytest.raises(InputError, match="the file of calibrated arms does not exist"):
        CalibratedArms.read(tmp_path / "none.json", arms.chains)


def test_arms_that_are_not_off_are_nothing_to_calibrate(arms: Arms) -> None:
    with pytest.raises(InputError, match="nothing to calibrate"):
        priors(arms.chains, Uncertainty())
