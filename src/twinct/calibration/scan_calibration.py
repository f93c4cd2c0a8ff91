"""Calibration of a scan: the estimated geometry is stored beside the believed one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import ExitStack
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
from twinct.core.errors import CalibrationError, InputError, ScanExistsError
from twinct.core.files.lock import sole_owner
from twinct.core.progress import Progress
from twinct.geometry import Floats, VolumeGrid
from twinct.geometry.wire import PosePairs
from twinct.observers import Audience, Observers, audience_of
from twinct.runs.folder import Folder
from twinct.runs.reconstruction import load_scan
from twinct.scan import NamedGeometry, Scan, free_geometry_name
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


def calibrate_beads(
    path: str | Path,
    *,
    name: str = "beads",
    others: Iterable[str | Path] = (),
    observers: Observers = (),
) -> BallCalibration:
    """Estimate the geometry of a phantom's scan, and store it beside the believed one.

    Args:
        path: folder of a run whose specimen is a phantom.
        name: name of the geometry.
        others: folders of runs with the same commanded views; they get the geometry, too.
        observers: notified of each view.

    Raises:
        CalibrationError: the specimen is no phantom, or no view can be calibrated.
        InputError: a reserved name, no scan, or a scan of other views; nothing is written.
        ScanExistsError: another geometry has this name; nothing is written.
    """
    free_geometry_name(name)
    folders = [Folder(Path(folder)) for folder in (path, *others)]
    scans = [load_scan(folder.path) for folder in folders]
    scan = scans[0]
    for folder, other in zip(folders[1:], scans[1:], strict=True):
        _same_views(folder.path, other, scan)
    with ExitStack() as stack:
        audience = stack.enter_context(audience_of(observers))
        for folder in folders:
            stack.enter_context(sole_owner(folder.lock))
        calibration = balls_of(scan, audience)
        made_by = {
            "model": "beads",
            "scan": scan.scenario.name,
            "told": len(scan) - len(calibration.problems),
            "rms_px": round(float(np.nanmedian(calibration.rms_px)), 4),
        }
        geometry = NamedGeometry(name, PosePairs.from_geometry(calibration.geometry), made_by)
        store_geometries([geometry] * len(folders), list(zip(folders, scans, strict=True)))
    return calibration


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


def calibrate_balls(
    path: str | Path,
    prior: PosePrior | None = None,
    *,
    radius_mm: float = 1.5,
    align: bool = False,
    name: str = "balls",
    observers: Observers = (),
) -> OnlineCalibrated:
    """Estimate and store the geometry of a scan from balls at unknown places on its specimen.

    Args:
        path: folder of a run.
        prior: spread of the errors; by default 0.5 mm and 0.2 deg, independent for each view.
        radius_mm: radius of each ball.
        align: as for ``calibrate_self``.
        name: name of the geometry.
        observers: notified of each round.

    Raises:
        CalibrationError: fewer than five balls are detected, or no view sees five.
        InputError: a reserved name, or no scan; nothing is written.
        ScanExistsError: another geometry has this name; nothing is written.
    """
    free_geometry_name(name)
    folder, prior = Folder(Path(path)), prior or PosePrior()
    scan = load_scan(folder.path)
    with audience_of(observers) as audience, sole_owner(folder.lock):
        panel = scan.settings.detector.panel
        believed = scan.believed.geometry(panel)
        estimate = online_calibrated(
            scan.transmission,
            believed,
            radius_mm,
            prior,
            blur_px=_blur_px(scan, audience),
            progress=audience,
        )
        executed = scan.relative.geometry(panel)
        points = _points_of(scan.settings.reconstruction.volume_grid)
        at_executed = aligned(estimate.geometry, executed, points)
        geometry = NamedGeometry(
            name,
            PosePairs.from_geometry(at_executed.geometry if align else estimate.geometry),
            {
                "model": "balls",
                "balls": len(estimate.bundle.balls),
                "radius_mm": radius_mm,
                "told": len(scan) - len(estimate.problems),
                "rms_px": round(estimate.rms_px, 4),
                "aligned": align,
                **scan.provenance.made_for,
                "believed": scan.reported.digest,
                **asdict(prior),
            },
        )
        store_geometries([geometry], [(folder, scan)])
    return OnlineCalibrated(estimate, aligned(believed, executed, points), at_executed)


def calibrate_self(
    path: str | Path,
    prior: PosePrior | None = None,
    *,
    what: What = "arms",
    start: Start = "believed",
    align: bool = False,
    name: str = "self",
    observers: Observers = (),
) -> SelfCalibrated:
    """Estimate and store the geometry of a scan from its own projections.

    Args:
        path: folder of a run; the grid of its scenario should hold the whole specimen.
        prior: spread of the errors; by default 0.5 mm and 0.2 deg, independent for each view.
        what: the part that may have moved: source and panel, or the patient between them.
        start: initial geometry; ``epipolar`` first corrects each view, without a volume, until it
            agrees with the other views on the planes through both sources.
        align: align the stored geometry with the executed one, by the seven modes that no image
            shows: figures then compare the volumes, not their positions.
        name: name of the geometry.
        observers: notified of each round.

    Raises:
        InputError: a reserved name, or no scan; nothing is written.
        ScanExistsError: another geometry has this name; nothing is written.
        CalibrationError: no view shares an informative plane with another one.
    """
    free_geometry_name(name)
    folder, prior = Folder(Path(path)), prior or PosePrior()
    scan = load_scan(folder.path)
    with audience_of(observers) as audience, sole_owner(folder.lock):
        panel, grid = scan.settings.detector.panel, scan.settings.reconstruction.volume_grid
        believed = scan.believed.geometry(panel)
        first, estimate = _from_projections(scan, prior, what, start, audience)
        executed, points = scan.relative.geometry(panel), _points_of(grid)
        at_executed = aligned(estimate.geometry, executed, points)
        stored = at_executed.geometry if align else estimate.geometry
        geometry = NamedGeometry(
            name,
            PosePairs.from_geometry(stored),
            {
                "model": "self",
                "what": what,
                "start": start,
                "aligned": align,
                **scan.provenance.made_for,
                "believed": scan.reported.digest,
                **asdict(prior),
            },
        )
        store_geometries([geometry], [(folder, scan)])
    return SelfCalibrated(
        estimate,
        aligned(believed, executed, points),
        at_executed,
        first,
        None if first is None else aligned(first.geometry, executed, points),
    )


def _from_projections(
    scan: Scan, prior: PosePrior, what: What, start: Start, progress: Progress
) -> tuple[EpipolarConsistency | None, SelfCalibration]:
    """Estimate a scan's geometry, by epipolar planes first if the start asks for it."""
    believed = scan.believed.geometry(scan.settings.detector.panel)
    mask = None if scan.bad_pixels is None else ~scan.bad_pixels
    p, grid = line_integrals(scan.transmission), scan.settings.reconstruction.volume_grid
    how: Any = {"what": what, "mask": mask, "progress": progress}
    if start != "epipolar":
        return None, self_calibrated(p, believed, grid, prior, **how)
    first = epipolar_consistent(p, believed, grid, prior, **how)
    return first, self_calibrated(p, believed, grid, prior, start=first.change, **how)


def _points_of(grid: VolumeGrid) -> Floats:
    """Return a grid's centre and four points around it, off by a sixth of its size, world, mm."""
    size = grid.voxel * np.array(grid.shape[::-1])
    about = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, -1, -1]])
    return grid.world_from_grid.apply(size / 6 * about)


def store_geometries(
    geometries: Sequence[NamedGeometry], where: Sequence[tuple[Folder, Scan]]
) -> None:
    """Store each geometry beside its scan.

    Raises:
        ScanExistsError: a scan has another geometry of this name; nothing is written.
    """
    for geometry, (folder, scan) in zip(geometries, where, strict=True):
        name = geometry.name
        if name in scan.derived and scan.derived[name].digest != geometry.digest:
            raise ScanExistsError(
                f"{folder.geometries / name}.json holds another geometry; choose another --as"
            )
    for geometry, (folder, _) in zip(geometries, where, strict=True):
        geometry.write(folder.geometries)


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
