"""Kinematic calibration of both arms from a phantom's scan, and its use for other scans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twinct.calibration import (
    ArmPrior,
    CalibratedArms,
    KinematicCalibration,
    PhantomViews,
    Resection,
    calibrated_arms,
    frames_of,
    require_same_arms,
)
from twinct.calibration.scan_calibration import balls_of, owners_of
from twinct.core.errors import InputError
from twinct.core.files.lock import sole_owner
from twinct.geometry import Chain, Floats, Panel, ScanGeometry
from twinct.observers import Audience
from twinct.robots.cell import nominal_chains
from twinct.runs.folder import Folder
from twinct.runs.reconstruction import load_scan
from twinct.scan import NamedGeometry, Scan, store_geometries
from twinct.scan.named_geometries import poses_digest
from twinct.scenario import AnyCell, Cell, Uncertainty
from twinct.uncertainty.drawn_tool import by_view
from twinct.uncertainty.error_terms import CONSTANT, Spread, ToolMotion
from twinct.uncertainty.nominal_scan import NominalScan
from twinct.uncertainty.terms.registry import terms_of
from twinct.uncertainty.terms.windup import mean_compliance

PLACED_MM, PLACED_DEG = 2.0, 1.0
"""Standard deviations of the phantom's pose in the room, after registration by nominal arms."""


def arm_prior(uncertainty: Uncertainty, motion: ToolMotion) -> ArmPrior:
    """Return the prior of an arm's errors that a scenario states.

    Args:
        uncertainty: errors of the scenario.
        motion: motion of the arm during the scan.

    Raises:
        InputError: the scenario states no errors of links or tools.
    """
    section, chain = uncertainty.arms.of(motion.side), motion.chain
    assert chain is not None  # a gantry has no arms to calibrate
    squares = {"base": np.array([PLACED_MM**2] * 3 + [np.radians(PLACED_DEG) ** 2] * 3)}
    squares |= {"links": np.zeros(6), "tool": np.zeros(6)}
    for term, settings in terms_of(uncertainty, motion.side):
        if term.prior is not None:
            for place, sigma in term.prior(settings).items():
                squares[place] += sigma**2
            continue
        for spread in term.spreads(settings, motion):
            if spread.length == CONSTANT and spread.draws != "none":
                _add_square(squares, spread)
    if not any(squares["links"]) and not any(squares["tool"]):
        raise InputError(
            "uncertainty.arms: links, zeros and tools have no errors, so there is nothing to "
            "calibrate; an uncertainty.preset sets their spread"
        )
    mean = mean_compliance(section, chain)
    return ArmPrior(
        base=np.sqrt(squares["base"]),
        link=np.sqrt(squares["links"]),
        tool=np.sqrt(squares["tool"]),
        compliance=mean,
        compliance_sigma=section.windup_spread * mean,
        gear=float(np.radians(section.gear_deg) / np.sqrt(2)),
    )


def _add_square(squares: dict[str, Floats], spread: Spread) -> None:
    """Add a spread that is constant over a scan, as a mean over views and joints."""
    square = by_view(spread) ** 2
    mean = square.reshape(-1, square.shape[-1]).mean(axis=0)
    if spread.place == "joints":  # acts like an error of the joints' zeros
        squares["links"][5] += mean.mean()
    else:
        squares["tool" if spread.place == "pose" else spread.place] += mean


def view_covariance(uncertainty: Uncertainty, motions: Sequence[ToolMotion]) -> Floats:
    """Return the covariance of each view's own errors, by ``resection.PARAMETERS``, (9, 9)."""
    squares = np.zeros((2, 6))
    for own, motion in zip(squares, motions, strict=True):
        for term, settings in terms_of(uncertainty, motion.side):
            for spread in term.spreads(settings, motion):
                if spread.place == "pose" and spread.length != CONSTANT:
                    own += (by_view(spread) ** 2).mean(axis=0)
    return np.diag(np.concatenate([squares[0, :3], squares[1]]))


def motions_of(scan: Scan, chains: tuple[Chain, Chain]) -> tuple[ToolMotion, ToolMotion]:
    """Return the motion of both arms by their encoders; each view is taken to stand still."""
    joints = scan.simulated.encoders.readings(scan.joints)
    nominal = NominalScan.of_arms(chains, joints, np.zeros_like(joints), scan.middle_s)
    return nominal.motion(0), nominal.motion(1)


def chains_of_scan(cell: AnyCell, panel: Panel) -> tuple[Chain, Chain]:
    """Return the nominal kinematic chains of a scan's arms, source first.

    Raises:
        InputError: the scenario has no arms.
    """
    if not isinstance(cell, Cell):
        raise InputError(f"cell.kind: {cell.kind}: a scan without joints has no arms to calibrate")
    return nominal_chains(cell, panel)


@dataclass(frozen=True)
class Kinematics:
    """Calibrate both arms from all views of a phantom of balls, and store them in DIR/arms.json.

    The scan is one of a specimen with a ball_helix.

    Attributes:
        to: Folders of scans of the same arms, along any trajectory, that get the geometry, too.
        arms: An arms.json; the scan then needs no balls.
    """

    to: tuple[Path, ...] = ()
    arms: Path | None = None

    def run(
        self, folder: Folder, name: str, audience: Audience
    ) -> KinematicCalibration | CalibratedArms:
        """Estimate, store and describe the arms and the geometry.

        Raises:
            CalibrationError: the specimen is no phantom, or too few views can be used.
            InputError: no scan, a scan without arms or with other arms, or no file of arms; nothing
                is written.
            ScanExistsError: another geometry has this name; nothing is written.
        """
        folders = [folder, *(Folder(other) for other in self.to)]
        if self.arms is not None:
            arms = [_apply(self.arms, name, one) for one in folders]
            audience.say(f"{name}: made with the arms in {self.arms}")
            return arms[0]
        fit = calibrate_arms(folders, name, audience)
        audience.say(
            f"{name}: arms calibrated from {fit.views} views; source off by "
            f"{fit.left_mm[0]:.3f} mm, panel by {fit.left_mm[1]:.3f} mm (RMS), "
            f"{fit.predicted_mm[0]:.3f} and {fit.predicted_mm[1]:.3f} mm in every "
            f"fifth view, predicted from the others; residuals {fit.misfit:.1f} times their noise; "
            f"stored in {folder.arms}"
        )
        for one in fit.undetermined:
            share = 100 * one.left
            audience.say(f"hardly determined ({share:.0f} % of its prior spread is left): {one}")
        return fit


def calibrate_arms(
    folders: Sequence[Folder], name: str, audience: Audience
) -> KinematicCalibration:
    """Calibrate the arms from the first folder's scan of a phantom; store arms and geometries."""
    scans = [load_scan(folder.path) for folder in folders]
    scan, scenario = scans[0], scans[0].scenario
    chains = chains_of_scan(scenario.cell, scenario.detector.panel)
    motions = motions_of(scan, chains)
    priors = [arm_prior(scenario.uncertainty, motion) for motion in motions]
    for folder, other in zip(folders[1:], scans[1:], strict=True):
        cell, panel = other.scenario.cell, other.scenario.detector.panel
        require_same_arms(frames_of(chains), chains_of_scan(cell, panel), str(folder.path))
    with owners_of(folders):
        views = balls_of(scan, audience).views
        arms = calibrated_arms(
            chains,
            phantom_views(scan, views, motions),
            (priors[0], priors[1]),
            gear_periods=scenario.uncertainty.arms.gear_periods,
        )
        _add(arms.arms, name, list(zip(folders, scans, strict=True)))
        arms.arms.write(folders[0].arms)
    return arms


def _apply(arms: Path, name: str, folder: Folder) -> CalibratedArms:
    """Compute and store the geometry of a scan from its encoder readings and calibrated arms."""
    scan = load_scan(folder.path)
    chains = chains_of_scan(scan.scenario.cell, scan.scenario.detector.panel)
    calibrated = CalibratedArms.read(arms, chains)
    with sole_owner(folder.lock):
        _add(calibrated, name, [(folder, scan)])
    return calibrated


def phantom_views(
    scan: Scan, views: tuple[Resection | None, ...], motions: Sequence[ToolMotion]
) -> PhantomViews:
    """Return encoder readings, geometry and covariance of the views that could be calibrated."""
    numbered = [(index, view) for index, view in enumerate(views) if view is not None]
    own = view_covariance(scan.scenario.uncertainty, motions)
    return PhantomViews(
        scan.simulated.encoders.readings(scan.joints)[[index for index, _ in numbered]],
        ScanGeometry.joined([view.geometry for _, view in numbered]),
        np.stack([view.covariance + own for _, view in numbered]),
    )


def _add(arms: CalibratedArms, name: str, where: list[tuple[Folder, Scan]]) -> None:
    added: list[tuple[NamedGeometry, Path]] = []
    for folder, scan in where:
        poses = arms.poses(scan.simulated.encoders.readings(scan.joints))
        made_by = {**arms.made_by, "executed": poses_digest(scan.executed)}
        added.append((NamedGeometry(name, poses, made_by), folder.geometries))
    store_geometries(added)
