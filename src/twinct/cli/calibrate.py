"""``twinct calibrate``: the executed poses of source and detector, by one of five methods."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from twinct.cli.arguments import Flag
from twinct.cli.optional import mark_optional
from twinct.cli.progress import on_terminal, say
from twinct.core.errors import InputError
from twinct.core.foreign_text import counted

if TYPE_CHECKING:
    from twinct.calibration import Aligned, CircularCalibration, EpipolarConsistency, PosePrior

calibrate = tyro.extras.SubcommandApp()

Run = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DIR")]
Name = Annotated[str, tyro.conf.arg(name="as", metavar="NAME", help="Name of the new geometry.")]
Others = Annotated[Sequence[Path], tyro.conf.arg(metavar="DIR")]


@dataclass(frozen=True)
class Errors:
    """Expected errors of the believed poses.

    Attributes:
        sigma_mm: Expected position error along each axis, mm.
        sigma_deg: Expected rotation error about each axis, degrees.
        correlation_views: Number of views over which errors are correlated; 0: independent errors.
        align: Move the result as a whole to the executed geometry, for figures that compare
            volumes.
    """

    sigma_mm: float = 0.5
    sigma_deg: float = 0.2
    correlation_views: float = 0.0
    align: Flag = False

    def prior(self) -> PosePrior:
        """Return the errors as a prior.

        Raises:
            InputError: a number is out of range.
        """
        from twinct.calibration import PosePrior

        for key, value in (("--sigma-mm", self.sigma_mm), ("--sigma-deg", self.sigma_deg)):
            if not value > 0:
                raise InputError(f"{key} {value:g}: must be more than 0")
        if not self.correlation_views >= 0:
            raise InputError(f"--correlation-views {self.correlation_views:g}: must be at least 0")
        return PosePrior(self.sigma_mm, self.sigma_deg, self.correlation_views)


Expected = Annotated[Errors, tyro.conf.arg(name="")]


def beads(folder: Run, *, as_: Name = "beads", to: Others = ()) -> None:
    """Calibrate each view from a phantom of balls at known positions.

    Args:
        folder: Folder of twinct run --out, of a specimen with a ball_helix.
        to: Folders of scans with the same views that get the geometry, too.
    """
    import numpy as np

    from twinct.calibration.scan_calibration import calibrate_beads

    with on_terminal() as audience:
        found = calibrate_beads(folder, name=as_, others=to, observers=audience)
    calibrated = [view for view in found.views if view]
    left_out = sum(int(view.outliers.sum()) for view in calibrated)
    say(
        f"{as_}: {len(calibrated)} of {len(found.views)} views calibrated, "
        f"median {np.median([len(view.shadows) for view in calibrated]):.0f} balls per view, "
        f"reprojection error {np.median([view.rms_px for view in calibrated]):.3f} px (median), "
        f"{counted(left_out, 'outlier')}"
    )
    for view, problem in sorted(found.problems.items()):
        say(f"view {view} keeps its believed pose: {problem}", warning=True)


def balls(
    folder: Run,
    *,
    as_: Name = "balls",
    ball_radius_mm: float = 1.5,
    errors: Expected = Errors(),  # noqa: B008
) -> None:
    """Calibrate a scan from a few balls at unknown positions on its specimen.

    Args:
        folder: Folder of twinct run --out.
        ball_radius_mm: Radius of each ball.
    """
    import numpy as np

    from twinct.calibration.scan_calibration import calibrate_balls

    prior = errors.prior()
    if not ball_radius_mm > 0:
        raise InputError(f"--ball-radius-mm {ball_radius_mm:g}: must be more than 0")
    with on_terminal() as audience:
        calibration = calibrate_balls(
            folder,
            prior,
            radius_mm=ball_radius_mm,
            align=errors.align,
            name=as_,
            observers=audience,
        )
    estimate, bundle = calibration.estimate, calibration.estimate.bundle
    seen = np.isfinite(bundle.residuals).all(axis=2).sum(axis=1)
    say(
        f"{as_}: {len(seen) - len(estimate.problems)} of {len(seen)} views calibrated, "
        f"{counted(len(bundle.balls), 'ball')} found, median {np.median(seen):.0f} per view, "
        f"reprojection error {estimate.rms_px:.3f} px (RMS), "
        f"{counted(bundle.outliers.sum(), 'outlier')}"
    )
    _say_against_executed(calibration.believed, calibration.after, folder)
    for view, ball in np.argwhere(bundle.outliers):
        place = ", ".join(f"{x:.1f}" for x in bundle.balls[ball])
        say(f"view {view}: the shadow of the ball at ({place}) mm is an outlier")
    for view, problem in sorted(estimate.problems.items()):
        say(f"view {view} keeps its believed pose: {problem}", warning=True)


def self_(
    folder: Run,
    *,
    as_: Name = "self",
    what: Literal["arms", "patient"] = "arms",
    start: Literal["believed", "epipolar"] = "believed",
    errors: Expected = Errors(),  # noqa: B008
) -> None:
    """Calibrate a scan from its projections alone: move each view until all views agree.

    Args:
        folder: Folder of twinct run --out.
        what: Parts that may have moved: source and panel, or the patient between them.
        start: Initial poses; epipolar: each view is first moved until it is consistent with other
            views in planes through both sources, without a volume.
    """
    import numpy as np

    from twinct.calibration.scan_calibration import calibrate_self

    prior = errors.prior()
    with on_terminal() as audience:
        calibration = calibrate_self(
            folder,
            prior,
            what=what,
            start=start,
            align=errors.align,
            name=as_,
            observers=audience,
        )
    if calibration.start is not None and calibration.started is not None:
        _say_start(calibration.start, calibration.started)
    estimate = calibration.estimate

    def rms(part: slice) -> float:
        return float(np.sqrt((estimate.change[:, part] ** 2).sum(axis=1).mean()))

    if what == "arms":
        moved = f"source moved by {rms(slice(0, 3)):.3f} mm, panel by {rms(slice(3, 6)):.3f} mm"
    else:
        moved = (
            f"patient moved by {rms(slice(0, 3)):.3f} mm, {np.degrees(rms(slice(3, 6))):.3f} deg"
        )
    say(
        f"{as_}: {counted(len(estimate.change), 'view')}, {moved} (RMS); residual "
        f"{estimate.residuals[0]:.4g} at first, {estimate.residuals[-1]:.4g} in the last round"
    )
    _say_against_executed(calibration.believed, calibration.after, folder)


def kinematics(
    folder: Run,
    *,
    as_: Name = "kinematics",
    to: Others = (),
    from_: Annotated[Path | None, tyro.conf.arg(name="from", metavar="FILE")] = None,
) -> None:
    """Calibrate both arms from all views of a phantom of balls, and store them in DIR/arms.json.

    Args:
        folder: Folder of twinct run --out, of a specimen with a ball_helix.
        to: Folders of scans of the same arms, along any trajectory, that get the geometry, too.
        from_: An arms.json; the scan then needs no balls.
    """
    from twinct.calibration.arm_calibration import apply_kinematics, calibrate_kinematics
    from twinct.runs import Folder

    if from_ is not None:
        with on_terminal() as audience:
            for path in (folder, *to):
                apply_kinematics(path, from_, name=as_, observers=audience)
        say(f"{as_}: made with the arms in {from_}")
        return
    with on_terminal() as audience:
        fit = calibrate_kinematics(folder, name=as_, others=to, observers=audience)
    say(
        f"{as_}: arms calibrated from {fit.views} views; source off by "
        f"{fit.left_mm[0]:.3f} mm, panel by {fit.left_mm[1]:.3f} mm (RMS), "
        f"{fit.predicted_mm[0]:.3f} and {fit.predicted_mm[1]:.3f} mm in every "
        f"fifth view, predicted from the others; residuals {fit.misfit:.1f} times their noise; "
        f"stored in {Folder(folder).arms}"
    )
    for one in fit.undetermined:
        say(f"hardly determined ({100 * one.left:.0f} % of its prior spread is left): {one}")


def circle(
    folder: Run,
    *,
    as_: Name = "circle",
    sigma_px: float = 5.0,
    sigma_deg: float = 1.0,
    sigma_sdd: float = 0.005,
) -> None:
    """Calibrate a circular scan from its projections alone: axis offset, roll, tilt, slant, SDD.

    Args:
        folder: Folder of twinct import --out or twinct run --out.
        sigma_px: Expected error of the axis, and of the panel's height, px.
        sigma_deg: Expected error of roll, tilt and slant, degrees.
        sigma_sdd: Expected error of the distance from source to panel, relative to it.
    """
    from twinct.calibration import CircularPrior
    from twinct.calibration.circle_calibration import calibrate_circle

    data = {"--sigma-px": sigma_px, "--sigma-deg": sigma_deg, "--sigma-sdd": sigma_sdd}
    for key, value in data.items():
        if not value > 0:
            raise InputError(f"{key} {value:g}: must be more than 0")
    prior = CircularPrior(sigma_px, sigma_sdd, sigma_deg)
    with on_terminal() as audience:
        calibration = calibrate_circle(folder, prior, name=as_, observers=audience)
    _say_circle(as_, calibration)


METHODS = {
    "beads": beads,
    "balls": balls,
    "self": self_,
    "circle": circle,
    "kinematics": kinematics,
}

for _name, _method in METHODS.items():
    calibrate.command(name=_name)(mark_optional(_method))


def _say_start(start: EpipolarConsistency, started: Aligned) -> None:
    import numpy as np

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


def _say_circle(name: str, circle: CircularCalibration) -> None:
    import numpy as np

    before, after, geometry = circle.before, circle.after, circle.geometry
    pitch_u = geometry.panel.pitch_u
    spread = dict(zip(("u", "v", "sdd", "tilt", "slant", "roll"), circle.deviation, strict=True))
    degrees = {key: np.degrees(spread[key]) for key in ("roll", "tilt", "slant")}
    say(
        f"{name}: the axis projects {_signed(after.axis_px, 2)} +- {spread['u'] / pitch_u:.2f} px "
        f"from the middle column (was {_signed(before.axis_px, 2)}); roll "
        f"{_signed(after.panel_roll_deg, 3)} +- {degrees['roll']:.3f} deg (was "
        f"{_signed(before.panel_roll_deg, 3)}); spread of the "
        f"differences {circle.residuals[0]:.4g} before, {circle.residuals[1]:.4g} after"
    )
    right, up = after.panel_offset_mm
    say(
        f"{name}, in place of an import's keys axis_ and panel_: sdd_mm: {after.sdd_mm:.4f}, "
        f"panel_offset_mm: [{right:.4f}, {up:.4f}], panel_roll_deg: {after.panel_roll_deg:.4f}, "
        f"panel_tilt_deg: {after.panel_tilt_deg:.4f}, panel_slant_deg: {after.panel_slant_deg:.4f}"
    )
    say(
        f"standard deviations, pixels and prior included: {spread['sdd']:.2g} mm of the SDD, "
        f"{spread['u']:.2g} and {spread['v']:.2g} mm of the offsets, {degrees['tilt']:.2g} deg of "
        f"the tilt and {degrees['slant']:.2g} deg of the slant"
    )
    for one in circle.undetermined:
        say(f"hardly determined ({100 * one.left:.0f} % of its prior spread is left): {one}")
    if circle.uncertain:
        say(f"not found precisely: {', '.join(circle.uncertain)}")
    say(
        f"not determined by any image: sod_mm ({after.sod_mm:g}), which scales the volume; the "
        "height of the volume and its turn about the axis"
    )


def _signed(value: float, digits: int) -> str:
    """Return a number with its sign; what rounds to 0 is not negative."""
    return f"{round(value, digits) + 0.0:+.{digits}f}"


def _say_against_executed(believed: Aligned, after: Aligned, folder: Path) -> None:
    from twinct.runs import Folder

    if Folder(folder).settings_of_scan().specimen is None:
        say(
            f"distance to the imported geometry: {after.after_px:.3f} px (RMS over points of the "
            f"grid, after removing the motion and scale that no image shows; scale "
            f"{after.scale:.5f}); no truth shows which is right: compare the residuals of both"
        )
        return
    say(
        f"distance to the executed geometry: {believed.after_px:.3f} px believed, "
        f"{after.after_px:.3f} px found (RMS over points of the grid, after removing the motion "
        f"and scale that no image shows; scale {after.scale:.5f})"
    )
