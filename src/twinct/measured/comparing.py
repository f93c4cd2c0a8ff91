"""Comparison of measured scans: their volumes side by side, and figures without a truth."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

import numpy as np

from twinct.core.errors import InputError
from twinct.core.foreign_text import counted
from twinct.geometry import Pose
from twinct.measured.volume_folder import MeasuredVolume, is_measured_scan, measured_volumes
from twinct.observers import Observers, audience_of
from twinct.report import Compared, MeasuredComparison, plain
from twinct.report.same_planes import Plane, layer_of, planes_through, section_at
from twinct.runs import Folder
from twinct.runs.reconstruction_folder import JUDGEMENT, check_files
from twinct.scan import ScanStore
from twinct.scenario import SECTIONS, Scenario
from twinct.version import __version__


def compare_measured(
    folders: Iterable[str | Path], observers: Observers = ()
) -> MeasuredComparison:
    """Compare volumes of measured scans with the first one.

    Args:
        folders: folders of ``import_measured``, of which all volumes count, or of single volumes,
            ``DIR/reconstructions/NAME``.
        observers: notified of the stage.

    Raises:
        InputError: a folder without a volume, a simulated run, or fewer than two volumes.
    """
    volumes: list[tuple[Folder, MeasuredVolume]] = []
    for path in map(Path, folders):
        volumes += _volumes(path)
    places = [one.path.resolve() for _, one in volumes]
    if len(set(places)) < len(places):
        raise InputError("a volume is given twice; each is compared once")
    if len(volumes) < 2:
        raise InputError(f"{counted(len(volumes), 'volume')}: at least two are needed")
    scans = [folder.path.resolve() for folder, _ in volumes]
    common = Path(os.path.commonpath([scan.parent for scan in scans]))
    planes: dict[str, Plane] = {}
    compared: list[Compared] = []
    with audience_of(observers) as audience, audience.stage("slices", len(volumes)) as step:
        for (folder, one), scan in zip(volumes, scans, strict=True):
            label = one.name if len(set(scans)) == 1 else f"{scan.relative_to(common)}:{one.name}"
            compared.append(_compared(folder, one, label, planes))
            step()
    return MeasuredComparison(tuple(compared))


def scan_folder(path: Path) -> Path:
    """Return the folder of the scan that a folder of a scan or of a volume belongs to."""
    whole = path.resolve()
    return whole.parents[1] if whole.parent.name == "reconstructions" else path


def _volumes(path: Path) -> list[tuple[Folder, MeasuredVolume]]:
    folder = Folder(scan_folder(path))
    if not is_measured_scan(folder.path):
        raise InputError(
            f"{path} is not a measured scan, so it cannot be compared with one; a simulated run is "
            "judged by its truth"
        )
    if folder.path is not path and (path / JUDGEMENT).is_file():
        check_files(path)
        return [(folder, MeasuredVolume.read(path))]
    volumes = measured_volumes(folder.reconstructions) if folder.path is path else {}
    if not volumes:
        raise InputError(f"{path} holds no volume yet; 'twinct reconstruct' makes one")
    return [(folder, one) for one in volumes.values()]


def _compared(
    folder: Folder, one: MeasuredVolume, label: str, planes: dict[str, Plane]
) -> Compared:
    """Cut a volume along the planes; choose those through the middle if there are none yet."""
    store = ScanStore(folder.scan)
    section = SECTIONS[str(one.settings["algorithm"])].model_validate(dict(one.settings))
    keys = {"geometry": one.geometry}
    scenario: Scenario = folder.scenario_of_run().model_copy(
        update={"reconstruction": section.model_copy(update=keys)}
    )
    volume = one.volume
    if not planes:
        half = volume.grid.size_mm / 2
        middle: Pose = volume.grid.world_from_grid
        planes |= planes_through(volume.grid, np.stack([-half, half]), middle, lambda _: True)
    slices = {}
    for name, plane in planes.items():
        layer = layer_of(plane, volume.grid)
        if layer is None:
            slices[name] = None
            continue
        nothing = np.zeros(layer.shape, np.float32)
        slices[name] = section_at(
            plane, volume.array, volume.grid, layer, nothing, np.ones(layer.shape, bool)
        )
    figures = plain(asdict(one.judgement))
    del figures["residual_by_view"]
    return Compared(
        label=label,
        path=str(one.path),
        scenario=scenario,
        metrics={
            "views": store.views,
            "reached": store.views,
            "twinct_version": __version__,
            "scenario_digest": store.digests["images"],
        },
        image=figures,
        in_words=one.in_words,
        seconds={"reconstruction": one.seconds},
        slices=slices,
        mu_reference=float("nan"),
        reference="",
        truth=store.digests["images"],
    )
