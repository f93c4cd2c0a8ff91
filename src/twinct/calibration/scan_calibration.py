"""Calibration of a scan: the estimated geometry is stored beside the believed one."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from twinct.calibration import (
    Aligned,
    BallCalibration,
    BallPhantom,
    EpipolarConsistency,
    OnlineCalibration,
    PosePrior,
    SelfCalibration,
    What,
    aligned,
    calibrated,
    epipolar_consistent,
    online_calibrated,
    self_calibrated,
)
from twinct.core.errors import CalibrationError, InputError
from twinct.core.files.lock import sole_owner
from twinct.core.foreign_text import counted
from twinct.core.progress import Progress
from twinct.geometry import Floats, VolumeGrid
from twinct.geometry.wire import PosePairs
from twinct.observers import Audience
from twinct.runs.folder import Folder
from twinct.runs.reconstruction import load_scan
from twinct.scan import NamedGeometry, Scan, store_geometries
from twinct.scan.integrals import line_integrals
from twinct.scenario import BallHelix, FileSpread, GaussianSpread, Specimen
from twinct.specimen.balls import nominal_centres

Start = Literal["believed", "epipolar"]
"""Start of self-calibration: the believed geometry, or the result of epipolar consistency."""

SAME_MM = 1e-6
"""Largest distance between commanded poses that count as the same view, mm."""


@dataclass(frozen=True, eq=False)
class SelfCalibrated:
    """Self-calibration of a scan, compared with the executed geometry.

    Attributes:
        estimate: the self-calibration.
        believed: the believed geometry, aligned with the executed one.
        after: the calibrated geometry, aligned with the executed one.
        start: result of epipolar consistency, if requested.
        started: geometry of ``start``, aligned with the executed one.
    """

    estimate: SelfCalibration
    believed: Aligned
    after: Aligned
    start: EpipolarConsistency | None = None
    started: Aligned | None = None


@dataclass(frozen=True, eq=False)
class OnlineCalibrated:
    """Calibration from balls on the specimen, compared with the executed geometry.

    Attributes:
        estimate: the calibration.
        believed: the believed geometry, aligned with the executed one.
        after: the calibrated geometry, aligned with the executed one.
    """

    estimate: OnlineCalibration
    believed: Aligned
    after: Aligned


def phantom_of(specimen: Specimen) -> BallPhantom:
    """Return the ball phantom of a specimen, at its nominal dimensions, in the world frame.

    Raises:
        CalibrationError: the specimen has no ``ball_helix``.
    """
    for part in specimen.parts:
        if isinstance(part.shape, BallHelix):
            shape = part.shape
            own = BallPhantom(nominal_centres(shape), shape.ball_radius_mm, shape.tolerance_mm)
            return specimen.world_from_specimen @ part.specimen_from_part @ own
    kinds = ", ".join(part.shape.kind for part in specimen.parts)
    raise CalibrationError(f"specimen.parts: no part is a ball_helix, only {kinds}")


@dataclass(frozen=True)
class Beads:
    """Calibrate each view from a phantom of balls at known positions.

    The scan is one of a specimen with a ball_helix.

    Attributes:
        to: Folders of scans with the same views that get the geometry, too.
    """

    to: tuple[Path, ...] = ()

    def run(self, folder: Folder, name: str, audience: Audience) -> BallCalibration:
        """Estimate, store and describe the geometry.

        Raises:
            CalibrationError: the specimen is no phantom, or no view can be calibrated.
            InputError: no scan, or a scan of other views; nothing is written.
            ScanExistsError: another geometry has this name; nothing is written.
        """
        folders = [folder, *(Folder(other) for other in self.to)]
        scans = [load_scan(folder.path) for folder in folders]
        scan = scans[0]
        for folder, other in zip(folders[1:], scans[1:], strict=True):
            _same_views(folder.path, other, scan)
        with owners_of(folders):
            calibration = balls_of(scan, audience)
            made_by = {
                "model": "beads",
                "scan": scan.scenario.name,
                "told": len(scan) - len(calibration.problems),
                "rms_px": round(float(np.nanmedian(calibration.rms_px)), 4),
            }
            geometry = NamedGeometry(name, PosePairs.from_geometry(calibration.geometry), made_by)
            store_geometries([(geometry, one.geometries) for one in folders])
        _say_beads(name, calibration, audience)
        return calibration


@contextmanager
def owners_of(folders: Iterable[Folder]) -> Generator[None, None, None]:
    """Own several folders."""
    with ExitStack() as stack:
        for folder in folders:
            stack.enter_context(sole_owner(folder.lock))
        yield


def balls_of(scan: Scan, audience: Audience) -> BallCalibration:
    """Calibrate each view of a phantom's scan from the shadows of the balls.

    Raises:
        CalibrationError: the specimen is no phantom, or no view can be calibrated.
    """
    return calibrated(
        scan.transmission,
        scan.believed.geometry(scan.settings.detector.panel),
        phantom_of(scan.scenario.specimen),
        blur_px=_blur_px(scan, audience),
        progress=audience,
    )


def _blur_px(scan: Scan, audience: Audience) -> float:
    """Return the sigma of the detector's point spread, pixels; 0 for a spread from a file."""
    panel, spread = scan.settings.detector.panel, scan.settings.detector.point_spread
    if isinstance(spread, FileSpread):
        audience.say("detector.point_spread is a file: shadows are taken as sharp", warning=True)
    return spread.sigma_mm / panel.pitch_u if isinstance(spread, GaussianSpread) else 0.0


@dataclass(frozen=True)
class Balls:
    """Calibrate a scan from a few balls at unknown positions on its specimen.

    Attributes:
        ball_radius_mm: Radius of each ball.
        errors: expected errors of the believed poses.
        align: Move the result as a whole to the executed geometry, by the seven modes that no image
            shows, for figures that compare volumes.
    """

    ball_radius_mm: float = 1.5
    errors: PosePrior = PosePrior()
    align: bool = False

    def __post_init__(self) -> None:
        """Raise ``InputError`` for a radius out of range."""
        if not self.ball_radius_mm > 0:
            raise InputError(f"ball_radius_mm {self.ball_radius_mm:g}: must be more than 0")

    def run(self, folder: Folder, name: str, audience: Audience) -> OnlineCalibrated:
        """Estimate, store and describe the geometry.

        Raises:
            CalibrationError: fewer than five balls are detected, or no view sees five.
            InputError: no scan; nothing is written.
            ScanExistsError: another geometry has this name; nothing is written.
        """
        scan = load_scan(folder.path)
        with sole_owner(folder.lock):
            panel = scan.settings.detector.panel
            believed = scan.believed.geometry(panel)
            estimate = online_calibrated(
                scan.transmission,
                believed,
                self.ball_radius_mm,
                self.errors,
                blur_px=_blur_px(scan, audience),
                progress=audience,
            )
            executed = scan.relative.geometry(panel)
            points = _points_of(scan.settings.reconstruction.volume_grid)
            at_executed = aligned(estimate.geometry, executed, points)
            stored = at_executed.geometry if self.align else estimate.geometry
            made_by = {
                "model": "balls",
                "balls": len(estimate.bundle.balls),
                "radius_mm": self.ball_radius_mm,
                "told": len(scan) - len(estimate.problems),
                "rms_px": round(estimate.rms_px, 4),
                "aligned": self.align,
                **scan.provenance.made_for,
                "believed": scan.reported.digest,
                **asdict(self.errors),
            }
            geometry = NamedGeometry(name, PosePairs.from_geometry(stored), made_by)
            store_geometries([(geometry, folder.geometries)])
        found = OnlineCalibrated(estimate, aligned(believed, executed, points), at_executed)
        _say_balls(name, found, scan, audience)
        return found


@dataclass(frozen=True)
class OwnProjections:
    """Calibrate a scan from its projections alone: move each view until all views agree.

    The grid of the scan's scenario should hold the whole specimen.

    Attributes:
        what: Parts that may have moved: source and panel, or the patient between them.
        start: Initial poses; epipolar: each view is first moved until it is consistent with other
            views in planes through both sources, without a volume.
        errors: expected errors of the believed poses.
        align: Move the result as a whole to the executed geometry, by the seven modes that no image
            shows, for figures that compare volumes.
    """

    what: What = "arms"
    start: Start = "believed"
    errors: PosePrior = PosePrior()
    align: bool = False

    def run(self, folder: Folder, name: str, audience: Audience) -> SelfCalibrated:
        """Estimate, store and describe the geometry.

        Raises:
            InputError: no scan; nothing is written.
            ScanExistsError: another geometry has this name; nothing is written.
            CalibrationError: no view shares an informative plane with another one.
        """
        scan = load_scan(folder.path)
        with sole_owner(folder.lock):
            panel, grid = scan.settings.detector.panel, scan.settings.reconstruction.volume_grid
            believed = scan.believed.geometry(panel)
            first, estimate = self._estimate(scan, audience)
            executed, points = scan.relative.geometry(panel), _points_of(grid)
            at_executed = aligned(estimate.geometry, executed, points)
            stored = at_executed.geometry if self.align else estimate.geometry
            made_by = {
                "model": "self",
                "what": self.what,
                "start": self.start,
                "aligned": self.align,
                **scan.provenance.made_for,
                "believed": scan.reported.digest,
                **asdict(self.errors),
            }
            geometry = NamedGeometry(name, PosePairs.from_geometry(stored), made_by)
            store_geometries([(geometry, folder.geometries)])
        found = SelfCalibrated(
            estimate,
            aligned(believed, executed, points),
            at_executed,
            first,
            None if first is None else aligned(first.geometry, executed, points),
        )
        _say_self(name, self.what, found, scan, audience)
        return found

    def _estimate(
        self, scan: Scan, progress: Progress
    ) -> tuple[EpipolarConsistency | None, SelfCalibration]:
        """Estimate a scan's geometry, by epipolar planes first if the start asks for it."""
        believed = scan.believed.geometry(scan.settings.detector.panel)
        mask = None if scan.bad_pixels is None else ~scan.bad_pixels
        p, grid = line_integrals(scan.transmission), scan.settings.reconstruction.volume_grid
        how: Any = {"what": self.what, "mask": mask, "progress": progress}
        if self.start != "epipolar":
            return None, self_calibrated(p, believed, grid, self.errors, **how)
        first = epipolar_consistent(p, believed, grid, self.errors, **how)
        return first, self_calibrated(p, believed, grid, self.errors, start=first.change, **how)


def _points_of(grid: VolumeGrid) -> Floats:
    """Return a grid's centre and four points around it, off by a sixth of its size, world, mm."""
    size = grid.voxel * np.array(grid.shape[::-1])
    about = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, -1, -1]])
    return grid.world_from_grid.apply(size / 6 * about)


def _same_views(path: Path, scan: Scan, phantom: Scan) -> None:
    """Raise unless a scan and the phantom's scan have the same commanded views.

    Raises:
        InputError: another number of views, or a view more than ``SAME_MM`` away.
    """
    if len(scan) != len(phantom):
        raise InputError(f"{path} has {len(scan)} views, but the phantom's scan has {len(phantom)}")
    for view in range(len(scan)):
        pairs = zip(scan.commanded[view], phantom.commanded[view], strict=True)
        far_mm = max(one.distance_mm(other) for one, other in pairs)
        if far_mm > SAME_MM:
            raise InputError(
                f"{path}: view {view} was commanded {far_mm:.3g} mm away from the phantom's scan; "
                "calibration needs identical views"
            )


def _say_beads(name: str, found: BallCalibration, audience: Audience) -> None:
    calibrated = [view for view in found.views if view]
    left_out = sum(int(view.outliers.sum()) for view in calibrated)
    audience.say(
        f"{name}: {len(calibrated)} of {len(found.views)} views calibrated, "
        f"median {np.median([len(view.shadows) for view in calibrated]):.0f} balls per view, "
        f"reprojection error {np.median([view.rms_px for view in calibrated]):.3f} px (median), "
        f"{counted(left_out, 'outlier')}"
    )
    _say_kept(found.problems, audience)


def _say_kept(problems: Mapping[int, str], audience: Audience) -> None:
    for view, problem in sorted(problems.items()):
        audience.say(f"view {view} keeps its believed pose: {problem}", warning=True)


def _say_balls(name: str, found: OnlineCalibrated, scan: Scan, audience: Audience) -> None:
    estimate, bundle = found.estimate, found.estimate.bundle
    seen = np.isfinite(bundle.residuals).all(axis=2).sum(axis=1)
    audience.say(
        f"{name}: {len(seen) - len(estimate.problems)} of {len(seen)} views calibrated, "
        f"{counted(len(bundle.balls), 'ball')} found, median {np.median(seen):.0f} per view, "
        f"reprojection error {estimate.rms_px:.3f} px (RMS), "
        f"{counted(bundle.outliers.sum(), 'outlier')}"
    )
    _say_distance(found.believed, found.after, scan, audience)
    for view, ball in np.argwhere(bundle.outliers):
        place = ", ".join(f"{x:.1f}" for x in bundle.balls[ball])
        audience.say(f"view {view}: the shadow of the ball at ({place}) mm is an outlier")
    _say_kept(estimate.problems, audience)


def _say_self(name: str, what: What, found: SelfCalibrated, scan: Scan, audience: Audience) -> None:
    if found.start is not None and found.started is not None:
        _say_start(found.start, found.started, audience)
    estimate = found.estimate

    def rms(part: slice) -> float:
        return float(np.sqrt((estimate.change[:, part] ** 2).sum(axis=1).mean()))

    if what == "arms":
        moved = f"source moved by {rms(slice(0, 3)):.3f} mm, panel by {rms(slice(3, 6)):.3f} mm"
    else:
        moved = (
            f"patient moved by {rms(slice(0, 3)):.3f} mm, {np.degrees(rms(slice(3, 6))):.3f} deg"
        )
    audience.say(
        f"{name}: {counted(len(estimate.change), 'view')}, {moved} (RMS); residual "
        f"{estimate.residuals[0]:.4g} at first, {estimate.residuals[-1]:.4g} in the last round"
    )
    _say_distance(found.believed, found.after, scan, audience)


def _say_start(start: EpipolarConsistency, started: Aligned, audience: Audience) -> None:
    views, planes = len(start.planes), int(start.planes.sum())
    audience.say(
        f"start: {views - len(start.problems)} of {views} views aligned by the planes they share "
        f"with others, median {np.median(start.planes):.0f} planes per view, "
        f"{start.complete.sum() / planes:.0%} of them with the specimen inside both panels; "
        f"difference {start.residuals[0]:.4g} before, {start.residuals[-1]:.4g} after; "
        f"{started.after_px:.3f} px from the executed geometry"
    )
    for view, problem in sorted(start.problems.items()):
        audience.say(f"view {view} starts from its believed pose: {problem}", warning=True)


def _say_distance(believed: Aligned, after: Aligned, scan: Scan, audience: Audience) -> None:
    if scan.settings.specimen is None:
        audience.say(
            f"distance to the imported geometry: {after.after_px:.3f} px (RMS over points of the "
            f"grid, after removing the motion and scale that no image shows; scale "
            f"{after.scale:.5f}); no truth shows which is right: compare the residuals of both"
        )
        return
    audience.say(
        f"distance to the executed geometry: {believed.after_px:.3f} px believed, "
        f"{after.after_px:.3f} px found (RMS over points of the grid, after removing the motion "
        f"and scale that no image shows; scale {after.scale:.5f})"
    )
