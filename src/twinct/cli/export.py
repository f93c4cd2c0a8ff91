"""Implementation of ``twinct export``: a scan, complete or in progress, for another toolkit."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from twinct.cli.progress import on_terminal
from twinct.core.errors import InputError, ScanExistsError
from twinct.core.files.writing import require_space, storage_errors
from twinct.exchange import Bundle, Toolkit, Values, bundle_bytes, write_bundle
from twinct.runs import line_integrals
from twinct.scan import OWN, ScanStore, named_geometries


def export_scan(scan: Path, toolkit: Toolkit, which: str, values: Values, out: Path | None) -> None:
    """Write the files from which a toolkit reconstructs a scan; arguments as in the command.

    Raises:
        InputError: there is no scan, or the toolkit does not support it; nothing was written.
    """
    path = _store_path(scan)
    out = path.parent / f"export-{toolkit}" if out is None else out
    if out.exists():
        raise ScanExistsError(f"{out} exists already: choose another --out")
    try:
        store = ScanStore(path)
        scenario, views = store.scenario, store.acquired  # a message names a broken store
    except (OSError, ValueError, KeyError) as error:
        raise InputError(f"{path}: not a readable scan: {error}") from None
    if not views:
        raise InputError(f"{path} holds 0 of {store.views} views: there is nothing to export yet")
    say = partial(Console().print, highlight=False, soft_wrap=True)
    if views < store.views:
        say(f"{path} is unfinished: exporting the {views} of {store.views} views it holds")
    # A scan in progress may have grown since the views were counted.
    derived = {} if which in OWN else named_geometries(path.parent / "geometries")
    if which not in OWN and which not in derived:
        raise InputError(f"--geometry {which}: unknown; choose from {', '.join((*OWN, *derived))}")
    poses = store.poses(which) if which in OWN else derived[which].poses
    geometry = poses.geometry(scenario.detector.panel)[:views]
    require_space(out, bundle_bytes(geometry), "the export needs")
    left = "the partial export was removed, the scan is unchanged"
    with (
        storage_errors(out, left),
        on_terminal() as audience,
        audience.stage("export", views) as step,
    ):

        def images() -> Iterator[NDArray[np.float32]]:
            for view in range(views):
                image = store.transmission(view)
                yield line_integrals(image) if values == "line-integrals" else image
                step()

        origin = {"scan": scenario.name, "scan digest": store.digests["images"], "geometry": which}
        origin["views"] = f"{views} of {store.views}"
        grid = scenario.reconstruction.volume_grid
        write_bundle(out, toolkit, Bundle(geometry, grid, images(), values, origin))
    say(f"wrote {out}; its README.txt says more")


def _store_path(scan: Path) -> Path:
    for path in (scan / "scan.zarr", scan):
        if (path / "zarr.json").is_file():
            return path.absolute()
    raise InputError(f"{scan} is neither a run folder nor a scan.zarr")
