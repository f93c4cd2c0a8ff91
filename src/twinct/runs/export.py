"""Export of a scan, complete or in progress, to another toolkit; or of a volume."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from twinct.core.arguments import kinds_checked
from twinct.core.errors import InputError, ScanExistsError
from twinct.core.files.writing import require_space, storage_errors
from twinct.core.foreign_text import quoted
from twinct.exchange import (
    Bundle,
    FormatName,
    Values,
    bundle_bytes,
    format_named,
    formats,
    write_bundle,
)
from twinct.observers import Observers, audience_of
from twinct.recon.volume_formats import volume_formats
from twinct.runs.folder import Folder
from twinct.runs.volume_export import Water, export_volume
from twinct.scan import ScanStore, line_integrals, named_geometries

ExportedValues = Literal["line-integrals", "transmission", "attenuation", "hounsfield"]
OF_SCAN = "line-integrals", "transmission"


@kinds_checked
def export(
    path: str | Path,
    to: str,
    *,
    volume: str | None = None,
    geometry: str | None = None,
    values: ExportedValues | None = None,
    water: float | None = None,
    air: float | None = None,
    out: str | Path | None = None,
    observers: Observers = (),
) -> Path:
    """Write a scan in a form that another toolkit can reconstruct, or one of its volumes.

    Args:
        path: folder of a run or of an imported scan; for the scan also its scan.zarr.
        to: name of a format; ``twinct.exchange.formats`` returns those of a scan,
            ``twinct.recon.volume_formats`` those of a volume.
        volume: ``volume``, ``truth``, or the name of a further reconstruction; None: the scan.
        geometry: name of a geometry of the scan; None: the one that the machine reports.
        values: pixels of a scan as line integrals (default) or transmission; voxels of a volume as
            attenuation (default) or in HU (default of dicom, where water is known).
        water: attenuation of water in the volume, 1/mm, which becomes 0 HU; None: see
            ``export_volume``.
        air: attenuation of air in the volume, 1/mm, which becomes -1000 HU; None: 0.
        out: the file or folder, which must not exist; None: ``export-NAME`` beside the scan.
        observers: notified of the stage.

    Returns:
        the file or folder.

    Raises:
        InputError: there is no such scan, volume or format, or an argument does not apply to it;
            nothing was written.
        ScanExistsError: the file or folder exists.
        StorageError: the disk is too small or not writable.
    """
    if volume is None:
        _refuse_volumes(to, values, water, air)
        taken = "transmission" if values == "transmission" else "line-integrals"
        return export_scan(path, to, geometry=geometry, values=taken, out=out, observers=observers)
    if geometry is not None or values in OF_SCAN:
        name = "--geometry" if geometry is not None else f"--values {values}"
        raise InputError(f"{name}: does not apply to a volume (--volume {volume})")
    if water is not None and values == "attenuation":
        raise InputError(f"--water {water:g}: defines HU, but --values is attenuation")
    if water is None and air is not None:
        raise InputError(f"--air {air:g}: HU need --water, too")
    how = "hounsfield" if values == "hounsfield" else "attenuation" if values else None
    stated = None if water is None else Water(water, air or 0.0)
    return export_volume(path, volume, to, values=how, water=stated, out=out, observers=observers)


def _refuse_volumes(to: str, values: str | None, water: float | None, air: float | None) -> None:
    """Raise if arguments of a volume are given, but no volume."""
    of_scan, of_volume = formats(), volume_formats()
    if to in of_volume and to not in of_scan:
        raise InputError(f"--to {to}: a format of volumes: name a volume with --volume")
    if to not in of_scan and to not in of_scan.broken:
        raise InputError(
            f"--to {quoted(to)}: unknown; choose from {', '.join(of_scan)} for the scan, or from "
            f"{', '.join(of_volume)} for a volume (--volume)"
        )
    for name, value in (("--water", water), ("--air", air), (f"--values {values}", values)):
        if value is not None and value not in OF_SCAN:
            raise InputError(f"{name}: applies to volumes only: name one with --volume")


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
