"""The command that estimates the executed poses of source and detector."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from twinct.calibration import Aligned, EpipolarConsistency, PosePrior, What
from twinct.cli.progress import on_terminal, say
from twinct.errors import InputError
from twinct.runs.calibrating import Start, calibrate_balls, calibrate_beads, calibrate_self
from twinct.runs.folder import Folder
from twinct.runs.kinematics import apply_kinematics, calibrate_kinematics


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
        moved = f"source by {rms(slice(0, 3)):.3f} mm, panel by {rms(slice(3, 6)):.3f} mm"
    else:
        moved = f"patient by {rms(slice(0, 3)):.3f} mm, {np.degrees(rms(slice(3, 6))):.3f} deg"
    say(
        f"{name or 'self'}: {len(found.change)} views, {moved} (RMS); residuals "
        f"{found.residuals[0]:.4g}, in the last round {found.residuals[-1]:.4g}"
    )
    _say_against_executed(told.believed, told.after)


def _say_start(start: EpipolarConsistency, started: Aligned) -> None:
    views, planes = len(start.planes), int(start.planes.sum())
    say(
        f"start: {views - len(start.problems)} of {views} views by planes they share with others, "
        f"{np.median(start.planes):.0f} in the middle view, {start.complete.sum() / planes:.0%} "
        f"of them with the specimen inside both panels; differences {start.residuals[0]:.4g}, "
        f"after it {start.residuals[-1]:.4g}; {started.after_px:.3f} px from the executed geometry"
    )
    for view, problem in sorted(start.problems.items()):
        say(f"view {view} starts as it was believed: {problem}", warning=True)


def balls_command(
    folder: Path, name: str | None, radius_mm: float, prior: PosePrior, *, align: bool
) -> None:
    """Calibrate from balls on the specimen, and report the result."""
    _require(prior)
    if not radius_mm > 0:
        raise InputError(f"--ball-radius-mm {radius_mm:g}: more than 0 needed")
    name = name or "balls"
    with on_terminal() as audience:
        told = calibrate_balls(
            folder, prior, radius_mm=radius_mm, align=align, name=name, observers=audience
        )
    found, bundle = told.found, told.found.bundle
    seen = np.isfinite(bundle.residuals).all(axis=2).sum(axis=1)
    say(
        f"{name}: {len(seen) - len(found.problems)} of {len(seen)} views, {len(bundle.balls)} "
        f"balls found, {np.median(seen):.0f} in the middle view, shadows off by "
        f"{found.rms_px:.3f} px (RMS), {bundle.outliers.sum()} outliers"
    )
    _say_against_executed(told.believed, told.after)
    for view, ball in np.argwhere(bundle.outliers):
        place = ", ".join(f"{x:.1f}" for x in bundle.balls[ball])
        say(f"view {view}: the shadow of the ball at ({place}) mm is an outlier")
    for view, problem in sorted(found.problems.items()):
        say(f"view {view} stays as it was believed: {problem}", warning=True)


def _require(prior: PosePrior) -> None:
    for key, value in (("--sigma-mm", prior.sigma_mm), ("--sigma-deg", prior.sigma_deg)):
        if not value > 0:
            raise InputError(f"{key} {value:g}: more than 0 needed")
    if not prior.correlation_views >= 0:
        raise InputError(f"--correlation-views {prior.correlation_views:g}: 0 or more needed")


def _say_against_executed(believed: Aligned, found: Aligned) -> None:
    say(
        f"against the executed geometry: {believed.after_px:.3f} px believed, "
        f"{found.after_px:.3f} px found (points of the grid, RMS, what no image shows taken "
        f"out; scale {found.scale:.5f})"
    )


def beads_command(folder: Path, name: str | None, to: Sequence[Path]) -> None:
    """Calibrate from a phantom of balls, and report the accuracy."""
    with on_terminal() as audience:
        found = calibrate_beads(folder, name=name or "beads", others=to, observers=audience)
    told = [view for view in found.views if view]
    left_out = sum(int(view.outliers.sum()) for view in told)
    say(
        f"{name or 'beads'}: {len(told)} of {len(found.views)} views, "
        f"{np.median([len(view.shadows) for view in told]):.0f} balls in the middle one, "
        f"reprojection error {np.median([view.rms_px for view in told]):.3f} px (median), "
        f"{left_out} outliers"
    )
    for view, problem in sorted(found.problems.items()):
        say(f"view {view} stays as it was believed: {problem}", warning=True)


def kinematics_command(
    folder: Path, name: str | None, to: Sequence[Path], arms: Path | None
) -> None:
    """Calibrate both arms, or use calibrated arms, and report the accuracy."""
    name = name or "kinematics"
    if arms is not None:
        with on_terminal() as audience:
            for path in (folder, *to):
                apply_kinematics(path, arms, name=name, observers=audience)
        say(f"{name}: by the arms of {arms}")
        return
    with on_terminal() as audience:
        found = calibrate_kinematics(folder, name=name, others=to, observers=audience)
    say(
        f"{name}: arms from {found.views} views; source off by {found.left_mm[0]:.3f} mm, panel by "
        f"{found.left_mm[1]:.3f} mm (RMS), {found.predicted_mm[0]:.3f} and "
        f"{found.predicted_mm[1]:.3f} mm in every fifth view predicted from the others; "
        f"residuals {found.misfit:.1f} times their noise; kept in {Folder(folder).arms}"
    )
    for one in found.untold:
        say(f"left to what was known before ({100 * one.left:.0f} % of its spread): {one}")
