"""A scan calibrated: what its geometry was found to be, beside the one that was believed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

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
from twinct.errors import CalibrationError, InputError, ScanExistsError
from twinct.files.lock import sole_owner
from twinct.geometry import Floats, VolumeGrid
from twinct.observers import Audience, Observers, audience_of
from twinct.runs.again import load_scan
from twinct.runs.folder import Folder
from twinct.runs.volumes import line_integrals
from twinct.scan import OWN, NamedGeometry, Scan, checked_name
from twinct.scan.named import poses_digest
from twinct.scenario import BallHelix, FileSpread, GaussianSpread, Scenario
from twinct.specimen.balls import nominal_centres
from twinct.views import PosePairs

Start = Literal["believed", "epipolar"]
"""What self-calibration goes on from: what was believed, or epipolar consistency."""

SAME_MM = 1e-6
"""Views asked for within this are the same."""


@dataclass(frozen=True, eq=False)
class SelfCalibrated:
    """What a scan found of itself, and how far that is from the truth of the simulation.

    Attributes:
        found: what was found.
        believed: what was believed, moved as a whole to where the executed geometry lies.
        after: what was found, moved so.
        start: what planes that views share say, where asked for.
        started: its geometry, moved so.
    """

    found: SelfCalibration
    believed: Aligned
    after: Aligned
    start: EpipolarConsistency | None = None
    started: Aligned | None = None


@dataclass(frozen=True, eq=False)
class OnlineCalibrated:
    """What balls on the specimen say, and how far that is from the truth of the simulation.

    Attributes:
        found: what was found.
        believed: what was believed, moved as a whole to where the executed geometry lies.
        after: what was found, moved so.
    """

    found: OnlineCalibration
    believed: Aligned
    after: Aligned


def phantom_of(scenario: Scenario) -> BallPhantom:
    """The balls of a scenario's specimen as its maker describes them, in the world.

    Raises:
        CalibrationError: there are none.
    """
    specimen = scenario.specimen
    for part in specimen.parts:
        if isinstance(part.shape, BallHelix):
            shape = part.shape
            own = BallPhantom(nominal_centres(shape), shape.ball_radius_mm, shape.tolerance_mm)
            return specimen.world_from_specimen @ part.specimen_from_part @ own
    kinds = ", ".join(part.shape.kind for part in specimen.parts)
    raise CalibrationError(f"specimen.parts: none is a ball_helix, there are {kinds}")


def calibrate_beads(
    path: str | Path,
    *,
    name: str = "beads",
    others: Iterable[str | Path] = (),
    observers: Observers = (),
) -> BallCalibration:
    """Find the geometry of a phantom's scan, and keep it beside the believed one.

    Args:
        path: folder of a run whose specimen is a phantom.
        name: of the geometry.
        others: folders of runs that asked for the same views; they get it, too.
        observers: hear of each view.

    Raises:
        CalibrationError: it is no phantom's scan, or no view can be told.
        InputError: a name that is taken, no scan, a scan of other views; nothing is written.
    """
    refuse_own(name)
    folders = [Folder(Path(folder)) for folder in (path, *others)]
    scans = [load_scan(folder.path) for folder in folders]
    scan = scans[0]
    for folder, other in zip(folders[1:], scans[1:], strict=True):
        _same_views(folder.path, other, scan)
    with ExitStack() as stack:
        audience = stack.enter_context(audience_of(observers))
        for folder in folders:
            stack.enter_context(sole_owner(folder.lock))
        found = balls_of(scan, audience)
        made_by = {
            "model": "beads",
            "scan": scan.scenario.name,
            "told": len(scan) - len(found.problems),
            "rms_px": round(float(np.nanmedian(found.rms_px)), 4),
        }
        geometry = NamedGeometry(name, PosePairs.from_geometry(found.geometry), made_by)
        keep([geometry] * len(folders), list(zip(folders, scans, strict=True)))
    return found


def balls_of(scan: Scan, audience: Audience) -> BallCalibration:
    """What the shadows of a phantom's balls say of its scan, view by view.

    Raises:
        CalibrationError: it is no phantom's scan, or no view can be told.
    """
    return calibrated(
        scan.transmission,
        scan.believed.geometry(scan.scenario.detector.panel),
        phantom_of(scan.scenario),
        blur_px=_blur_px(scan, audience),
        progress=audience,
    )


def _blur_px(scan: Scan, audience: Audience) -> float:
    """Sigma of the detector's blur."""
    panel, spread = scan.scenario.detector.panel, scan.scenario.detector.point_spread
    if isinstance(spread, FileSpread):
        audience.say("detector.point_spread is of a file: shadows count as sharp", warning=True)
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
    """Find the geometry of a scan from balls at unknown places on its specimen, and keep it.

    Args:
        path: folder of a run.
        prior: what is known of the errors; 0.5 mm and 0.2 deg, each view's own, unless given.
        radius_mm: of each ball.
        align: as for ``calibrate_self``.
        name: of the geometry.
        observers: hear of each round.

    Raises:
        CalibrationError: fewer than five balls are found, or no view sees as many.
        InputError: a name that is taken, no scan; nothing is written.
    """
    refuse_own(name)
    folder, prior = Folder(Path(path)), prior or PosePrior()
    scan = load_scan(folder.path)
    with audience_of(observers) as audience, sole_owner(folder.lock):
        panel = scan.scenario.detector.panel
        believed = scan.believed.geometry(panel)
        found = online_calibrated(
            scan.transmission,
            believed,
            radius_mm,
            prior,
            blur_px=_blur_px(scan, audience),
            progress=audience,
        )
        executed = scan.relative.geometry(panel)
        points = _points_of(scan.scenario.reconstruction.volume_grid)
        at_executed = aligned(found.geometry, executed, points)
        geometry = NamedGeometry(
            name,
            PosePairs.from_geometry(at_executed.geometry if align else found.geometry),
            {
                "model": "balls",
                "balls": len(found.bundle.balls),
                "radius_mm": radius_mm,
                "told": len(scan) - len(found.problems),
                "rms_px": round(found.rms_px, 4),
                "aligned": align,
                "executed": poses_digest(scan.executed),
                "believed": scan.reported.digest,
                **asdict(prior),
            },
        )
        keep([geometry], [(folder, scan)])
    return OnlineCalibrated(found, aligned(believed, executed, points), at_executed)


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
    """Find the geometry of a scan from its own projections, and keep it beside the believed one.

    Args:
        path: folder of a run; the grid of its scenario should hold the whole specimen.
        prior: what is known of the errors; 0.5 mm and 0.2 deg, each view's own, unless given.
        what: may have moved: source and panel, or the patient between them.
        start: what to go on from; epipolar first moves each view, without a volume, until it tells
            the same as others of planes through both sources.
        align: keep the geometry moved as a whole to where the executed one lies, by the seven modes
            that no image shows: figures then compare volumes, not where they lie.
        name: of the geometry.
        observers: hear of each round.

    Raises:
        InputError: a name that is taken, no scan; nothing is written.
        CalibrationError: no view shares planes with others that tell something.
    """
    refuse_own(name)
    folder, prior = Folder(Path(path)), prior or PosePrior()
    scan = load_scan(folder.path)
    with audience_of(observers) as audience, sole_owner(folder.lock):
        panel, grid = scan.scenario.detector.panel, scan.scenario.reconstruction.volume_grid
        believed = scan.believed.geometry(panel)
        p = line_integrals(scan.transmission)
        mask = None if scan.bad_pixels is None else ~scan.bad_pixels
        first = None
        if start == "epipolar":
            first = epipolar_consistent(
                p, believed, grid, prior, what=what, mask=mask, progress=audience
            )
        found = self_calibrated(
            p,
            believed,
            grid,
            prior,
            what=what,
            mask=mask,
            start=None if first is None else first.change,
            progress=audience,
        )
        executed, points = scan.relative.geometry(panel), _points_of(grid)
        at_executed = aligned(found.geometry, executed, points)
        kept = at_executed.geometry if align else found.geometry
        geometry = NamedGeometry(
            name,
            PosePairs.from_geometry(kept),
            {
                "model": "self",
                "what": what,
                "start": start,
                "aligned": align,
                "executed": poses_digest(scan.executed),
                "believed": scan.reported.digest,
                **asdict(prior),
            },
        )
        keep([geometry], [(folder, scan)])
    return SelfCalibrated(
        found,
        aligned(believed, executed, points),
        at_executed,
        first,
        None if first is None else aligned(first.geometry, executed, points),
    )


def _points_of(grid: VolumeGrid) -> Floats:
    """The middle of a grid and four points about it, a sixth of its size away, mm."""
    size = grid.voxel * np.array(grid.shape[::-1])
    about = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, -1, -1]])
    return grid.world_from_grid.apply(size / 6 * about)


def refuse_own(name: str) -> None:
    """Refuse the names that every scan has.

    Raises:
        InputError: it is one, or may not be a file's.
    """
    if checked_name(name) in OWN:
        raise InputError(f"name {name!r}: every scan has {', '.join(OWN)} already")


def keep(geometries: Sequence[NamedGeometry], where: Sequence[tuple[Folder, Scan]]) -> None:
    """Keep a geometry beside each of some scans.

    Raises:
        ScanExistsError: another one has its name there; nothing is written.
    """
    for geometry, (folder, scan) in zip(geometries, where, strict=True):
        name = geometry.name
        if name in scan.derived and scan.derived[name].digest != geometry.digest:
            raise ScanExistsError(f"{folder.geometries / name}.json is another geometry: --as")
    for geometry, (folder, _) in zip(geometries, where, strict=True):
        geometry.write(folder.geometries)


def _same_views(path: Path, scan: Scan, phantom: Scan) -> None:
    """Refuse a scan that went elsewhere.

    Raises:
        InputError: it did.
    """
    if len(scan) != len(phantom):
        raise InputError(f"{path} has {len(scan)} views, the phantom's scan {len(phantom)}")
    for view in range(len(scan)):
        pairs = zip(scan.commanded[view], phantom.commanded[view], strict=True)
        far_mm = max(one.distance_mm(other) for one, other in pairs)
        if far_mm > SAME_MM:
            raise InputError(
                f"{path}: view {view} was asked for {far_mm:.3g} mm beside the phantom's scan: "
                "calibration is of the same views"
            )
