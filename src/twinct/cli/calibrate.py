"""The command that estimates the executed poses of source and detector."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from twinct.calibration import Aligned, EpipolarConsistency, PosePrior, What
from twinct.calibration.arm_calibration import apply_kinematics, calibrate_kinematics
from twinct.calibration.scan_calibration import (
    Start,
    calibrate_balls,
    calibrate_beads,
    calibrate_self,
)
from twinct.cli.progress import on_terminal, say
from twinct.core.errors import InputError
from twinct.runs.folder import Folder


def self_command(
    folder: Path, name: str | None, prior: PosePrior, what: What, start: Start, *, align: bool
) -> None:
    """Calibrate from the scan itself, and report the result."""
    _require(prior)
    with on_terminal() as audience:
        told = calibrate_self(
            folder,
            prior,
            what=what,
            start=start,
            align=align,
            name=name or "self",
            observers=audience,
        )
    if told.start is not None and told.started is not None:
        _say_start(told.start, told.started)
    found = told.found

    def rms(part: slice) -> float:
        return float(np.sqrt((found.change[:, part] ** 2).sum(axis=1).mean()))

    if what == "arms":
        moved = f"source moved by {rms(slice(0, 3)):.3f} mm, panel by {rms(slice(3, 6)):.3f} mm"
    else:
        moved = (
            f"patient moved by {rms(slice(0, 3)):.3f} mm, {np.degrees(rms(slice(3, 6))):.3f} deg"
        )
    say(
        f"{name or 'self'}: {len(found.change)} views, {moved} (RMS); residual "
        f"{found.residuals[0]:.4g} at first, {found.residuals[-1]:.4g} in the last round"
    )
    _say_against_executed(told.believed, told.after)


def _say_start(start: EpipolarConsistency, started: Aligned) -> None:
    views, planes = len(start.planes), int(start.planes.sum())
    say(
        f"start: {views - len(start.problems)} of {views} views aligned by the planes they share "
        f"with others, median {np.median(start.planes):.0f} planes per view, "
        f"{start.complete.sum() / planes:.0%} of them with the specimen inside both panels; "
        f"difference {start.residuals[0]:.4g} before, {start.residuals[-1]:.4g} after; "
        f"{started.after_px:.3f} px from the executed geometry"
    )
    for view, problem in sorted(start.problems.items()):
        say(f"view {view} starts from its believed pose: {problem}", warning=True)


def balls_command(
    folder: Path, name: str | None, radius_mm: float, prior: PosePrior, *, align: bool
) -> None:
    """Calibrate from balls on the specimen, and report the result."""
    _require(prior)
    if not radius_mm > 0:
        raise InputError(f"--ball-radius-mm {radius_mm:g}: must be more than 0")
    name = name or "balls"
    with on_terminal() as audience:
        told = calibrate_balls(
            folder, prior, radius_mm=radius_mm, align=align, name=name, observers=audience
        )
    found, bundle = told.found, told.found.bundle
    seen = np.isfinite(bundle.residuals).all(axis=2).sum(axis=1)
    say(
        f"{name}: {len(seen) - len(found.problems)} of {len(seen)} views calibrated, "
        f"{len(bundle.balls)} balls found, median {np.median(seen):.0f} per view, reprojection "
        f"error {found.rms_px:.3f} px (RMS), {bundle.outliers.sum()} outliers"
    )
    _say_against_executed(told.believed, told.after)
    for view, ball in np.argwhere(bundle.outliers):
        place = ", ".join(f"{x:.1f}" for x in bundle.balls[ball])
        say(f"view {view}: the shadow of the ball at ({place}) mm is an outlier")
    for view, problem in sorted(found.problems.items()):
        say(f"view {view} keeps its believed pose: {problem}", warning=True)


def _require(prior: PosePrior) -> None:
    for key, value in (("--sigma-mm", prior.sigma_mm), ("--sigma-deg", prior.sigma_deg)):
        if not value > 0:
            raise InputError(f"{key} {value:g}: must be more than 0")
    if not prior.correlation_views >= 0:
        raise InputError(f"--correlation-views {prior.correlation_views:g}: must be at least 0")


def _say_against_executed(believed: Aligned, found: Aligned) -> None:
    say(
        f"distance to the executed geometry: {believed.after_px:.3f} px believed, "
        f"{found.after_px:.3f} px found (RMS over points of the grid, after removing the motion "
        f"and scale that no image shows; scale {found.scale:.5f})"
    )


def beads_command(folder: Path, name: str | None, to: Sequence[Path]) -> None:
    """Calibrate from a phantom of balls, and report the accuracy."""
    with on_terminal() as audience:
        found = calibrate_beads(folder, name=name or "beads", others=to, observers=audience)
    told = [view for view in found.views if view]
    left_out = sum(int(view.outliers.sum()) for view in told)
    say(
        f"{name or 'beads'}: {len(told)} of {len(found.views)} views calibrated, "
        f"median {np.median([len(view.shadows) for view in told]):.0f} balls per view, "
        f"reprojection error {np.median([view.rms_px for view in told]):.3f} px (median), "
        f"{left_out} outliers"
    )
    for view, problem in sorted(found.problems.items()):
        say(f"view {view} keeps its believed pose: {problem}", warning=True)


def kinematics_command(
    folder: Path, name: str | None, to: Sequence[Path], arms: Path | None
) -> None:
    """Calibrate both arms, or use calibrated arms, and report the accuracy."""
    name = name or "kinematics"
    if arms is not None:
        with on_terminal() as audience:
            for path in (folder, *to):
                apply_kinematics(path, arms, name=name, observers=audience)
        say(f"{name}: made with the arms in {arms}")
        return
    with on_terminal() as audience:
        found = calibrate_kinematics(folder, name=name, others=to, observers=audience)
    say(
        f"{name}: arms calibrated from {found.views} views; source off by "
        f"{found.left_mm[0]:.3f} mm, panel by {found.left_mm[1]:.3f} mm (RMS), "
        f"{found.predicted_mm[0]:.3f} and {found.predicted_mm[1]:.3f} mm in every "
        f"fifth view, predicted from the others; residuals {found.misfit:.1f} times their noise; "
        f"stored in {Folder(folder).arms}"
    )
    for one in found.untold:
        say(f"hardly determined ({100 * one.left:.0f} % of its prior spread is left): {one}")
