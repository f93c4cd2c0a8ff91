"""Both arms of a cell calibrated by a phantom's scan, and what that says of other scans."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from twinct.calibration import (
    ArmPrior,
    CalibratedArms,
    KinematicCalibration,
    Resection,
    Seen,
    calibrated_arms,
    frames_of,
    require_same_arms,
)
from twinct.errors import InputError
from twinct.files.lock import sole_owner
from twinct.geometry import Chain, Floats, ScanGeometry
from twinct.observers import Observers, audience_of
from twinct.runs.again import load_scan
from twinct.runs.calibrating import balls_of, keep, refuse_own
from twinct.runs.folder import Folder
from twinct.scan import NamedGeometry, Scan
from twinct.scan.named import poses_digest
from twinct.scan.told import encoders_of
from twinct.scenario import Cell, Scenario, Uncertainty
from twinct.uncertainty.arms import mean_compliance, spreads
from twinct.uncertainty.executed import view_sigmas

PLACED_MM, PLACED_DEG = 2.0, 1.0
"""What is left of the phantom's place in the room once nominal arms have told it."""


def arm_prior(uncertainty: Uncertainty, chain: Chain) -> ArmPrior:
    """What a scenario says of how far an arm may be off.

    Raises:
        InputError: it says that nothing is.
    """
    section = uncertainty.arms
    squares = {"base": np.array([PLACED_MM**2] * 3 + [np.radians(PLACED_DEG) ** 2] * 3)}
    squares |= {"links": np.zeros(6), "tool": np.zeros(6)}
    for spread in spreads(section):
        squares[spread.frame] += spread.sigma**2
    # What is missing of each link's growth is a length like others while a scan lasts.
    squares["links"][:3] += section.drift_mm**2
    if not any(squares["links"]) and not any(squares["tool"]):
        raise InputError(
            "uncertainty.arms: links, zeros and tools are not off: nothing to calibrate; an "
            "uncertainty.preset says by how much they may be"
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


def view_covariance(uncertainty: Uncertainty) -> Floats:
    """Of source and panel about where their arms are, as of ``resection.PARAMETERS``, (9, 9)."""
    source, panel = view_sigmas(uncertainty.views)
    return np.diag(np.concatenate([source[:3], panel]) ** 2)


def chains_of_scan(scenario: Scenario) -> tuple[Chain, Chain]:
    """Nominal arms of a scenario.

    Raises:
        InputError: it has none.
    """
    if not isinstance(scenario.cell, Cell):
        raise InputError(
            f"cell.kind: {scenario.cell.kind}: a scan without joints has no arms to calibrate"
        )
    from twinct.cell import nominal_chains

    return nominal_chains(scenario.cell, scenario.detector.panel)


def calibrate_kinematics(
    path: str | Path,
    *,
    name: str = "kinematics",
    others: Iterable[str | Path] = (),
    observers: Observers = (),
) -> KinematicCalibration:
    """Find both arms from a phantom's scan, keep them in ``arms.json``, and the geometry beside it.

    Args:
        path: folder of a run whose specimen is a phantom.
        name: of the geometry.
        others: folders of runs of the same arms, along any trajectory; they get it, too.
        observers: hear of each view.

    Raises:
        CalibrationError: it is no phantom's scan, or does not tell enough.
        InputError: a name that is taken, no scan, none of arms, or of others; nothing is written.
    """
    refuse_own(name)
    folders = [Folder(Path(folder)) for folder in (path, *others)]
    scans = [load_scan(folder.path) for folder in folders]
    scan, scenario = scans[0], scans[0].scenario
    chains = chains_of_scan(scenario)
    priors = [arm_prior(scenario.uncertainty, chain) for chain in chains]
    for folder, other in zip(folders[1:], scans[1:], strict=True):
        require_same_arms(frames_of(chains), chains_of_scan(other.scenario), str(folder.path))
    with ExitStack() as stack:
        audience = stack.enter_context(audience_of(observers))
        for folder in folders:
            stack.enter_context(sole_owner(folder.lock))
        views = balls_of(scan, audience).views
        found = calibrated_arms(
            chains,
            seen_by(scan, views),
            (priors[0], priors[1]),
            gear_periods=scenario.uncertainty.arms.gear_periods,
        )
        _add(found.arms, name, list(zip(folders, scans, strict=True)))
        found.arms.write(folders[0].arms)
    return found


def apply_kinematics(
    path: str | Path, arms: str | Path, *, name: str = "kinematics", observers: Observers = ()
) -> CalibratedArms:
    """Add what calibrated arms say of a scan's joints to it, as a geometry.

    Args:
        path: folder of a run.
        arms: file of ``calibrate_kinematics``.
        name: of the geometry.
        observers: hear of it.

    Raises:
        InputError: a name that is taken, no scan, no such file, or one of another cell.
    """
    refuse_own(name)
    folder = Folder(Path(path))
    scan = load_scan(folder.path)
    found = CalibratedArms.read(Path(arms), chains_of_scan(scan.scenario))
    with audience_of(observers), sole_owner(folder.lock):
        _add(found, name, [(folder, scan)])
    return found


def seen_by(scan: Scan, views: tuple[Resection | None, ...]) -> Seen:
    """What the balls of a phantom's scan tell, with the joints of the views that were told."""
    told = [(index, view) for index, view in enumerate(views) if view is not None]
    own = view_covariance(scan.scenario.uncertainty)
    return Seen(
        encoders_of(scan.scenario, scan.joints)[[index for index, _ in told]],
        ScanGeometry.joined([view.geometry for _, view in told]),
        np.stack([view.covariance + own for _, view in told]),
    )


def _add(arms: CalibratedArms, name: str, where: list[tuple[Folder, Scan]]) -> None:
    found: list[NamedGeometry] = []
    for _, scan in where:
        poses = arms.poses(encoders_of(scan.scenario, scan.joints))
        made_by = {**arms.made_by, "executed": poses_digest(scan.executed)}
        found.append(NamedGeometry(name, poses, made_by))
    keep(found, where)
