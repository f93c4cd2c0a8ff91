"""Export of a scan, complete or in progress, to another toolkit."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twinct.core.errors import InputError, ScanExistsError
from twinct.core.files.writing import require_space, storage_errors
from twinct.exchange import Bundle, FormatName, Values, bundle_bytes, format_named, write_bundle
from twinct.observers import Observers, audience_of
from twinct.runs.folder import Folder
from twinct.scan import ScanStore, line_integrals, named_geometries


def export_scan(
    path: str | Path,
    to: FormatName,
    *,
    geometry: str | None = None,
    values: Values = "line-integrals",
    out: str | Path | None = None,
    observers: Observers = (),
) -> Path:
    """Write the files from which a toolkit reconstructs a scan, and return their folder.

    Args:
        path: folder of a run, or its scan.zarr.
        to: name of a format; ``twinct.exchange.formats`` returns all of them.
        geometry: name of a geometry; None: the one that the machine reports.
        values: quantity in the pixels.
        out: the folder, which must not exist; None: ``export-NAME`` beside the scan.
        observers: notified of the stage.

    Raises:
        InputError: there is no scan or no such format, or the format does not support the scan;
            nothing was written.
        ScanExistsError: the folder exists.
        StorageError: the folder cannot be written, or the disk is too small.
    """
    format_named(to)
    path = _store_path(Path(path))
    out = path.parent / f"export-{to}" if out is None else Path(out)
    if out.exists():
        raise ScanExistsError(f"{out} exists already: choose another --out")
    try:
        store = ScanStore(path)
        settings, views = store.settings, store.acquired  # a message names a broken store
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{path}: not a readable scan: {error}") from None
    if not views:
        raise InputError(f"{path} holds 0 of {store.views} views: there is nothing to export yet")
    # A scan in progress may have grown since the views were counted.
    provenance = store.provenance
    geometry = geometry or provenance.reported.name
    poses = provenance.poses(geometry)
    if poses is None:
        derived = named_geometries(path.parent / "geometries")
        if geometry not in derived:
            known = ", ".join((*provenance.own, *derived))
            raise InputError(f"--geometry {geometry}: unknown; choose from {known}")
        poses = derived[geometry].poses
    chosen = poses.geometry(settings.detector.panel)[:views]
    require_space(out, bundle_bytes(chosen), "the export needs")
    left = "the partial export was removed, the scan is unchanged"
    with (
        storage_errors(out, left),
        audience_of(observers) as audience,
        audience.stage("export", views) as step,
    ):
        if views < store.views:
            audience.say(
                f"{path} is unfinished: exporting the {views} of {store.views} views it holds"
            )

        def images() -> Iterator[NDArray[np.float32]]:
            for view in range(views):
                image = store.transmission(view)
                yield line_integrals(image) if values == "line-integrals" else image
                step()

        origin = {"scan": settings.name, "scan digest": store.digests["images"]}
        origin |= {"geometry": geometry, "views": f"{views} of {store.views}"}
        grid = settings.reconstruction.volume_grid
        write_bundle(out, to, Bundle(chosen, grid, images(), values, origin))
    return out


def _store_path(scan: Path) -> Path:
    for path in (Folder(scan).scan, scan):
        if (path / "zarr.json").is_file():
            return path.absolute()
    raise InputError(f"{scan} is neither a run folder nor a scan.zarr")
