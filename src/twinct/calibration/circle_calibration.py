"""Calibration of a circular scan: its numbers, and the geometry that is stored beside it."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from twinct.calibration.circular import CircularCalibration, CircularPrior, circular_consistent
from twinct.calibration.scan_calibration import store_geometries
from twinct.core.errors import CalibrationError
from twinct.core.files.lock import sole_owner
from twinct.geometry.wire import PosePairs
from twinct.observers import Observers, audience_of
from twinct.runs.folder import Folder
from twinct.runs.reconstruction import load_scan
from twinct.scan import NamedGeometry, free_geometry_name
from twinct.scan.integrals import line_integrals


def calibrate_circle(
    path: str | Path,
    prior: CircularPrior | None = None,
    *,
    name: str = "circle",
    observers: Observers = (),
) -> CircularCalibration:
    """Estimate and store the geometry of a circular scan from its own projections.

    Args:
        path: folder of a run or of an imported scan.
        prior: spread of the errors.
        name: name of the geometry.
        observers: notified of each resolution.

    Raises:
        InputError: a reserved name, no scan, or no circle; nothing is written.
        ScanExistsError: another geometry has this name; nothing is written.
        CalibrationError: no view shares an informative plane with another one, or the geometry that
            was found explains the views no better than the believed one; nothing is written.
    """
    free_geometry_name(name)
    folder, prior = Folder(Path(path)), prior or CircularPrior()
    scan = load_scan(folder.path)
    with audience_of(observers) as audience, sole_owner(folder.lock):
        calibration = circular_consistent(
            line_integrals(scan.transmission),
            scan.geometry(),
            prior,
            mask=None if scan.bad_pixels is None else ~scan.bad_pixels,
            progress=audience,
        )
        first, last = calibration.residuals
        if last >= first:
            raise CalibrationError(
                f"the geometry found is no better than the believed one, which is kept (spread of "
                f"differences {last:.4g}, {first:.4g} before). The object should lie within the "
                "panel in all views, and have fine structure"
            )
        made_by = {"model": "circle", "believed": scan.reported.digest, **asdict(prior)}
        geometry = NamedGeometry(name, PosePairs.from_geometry(calibration.geometry), made_by)
        store_geometries([geometry], [(folder, scan)])
    return calibration
